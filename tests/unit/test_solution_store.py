"""Solutions taken apart and put together again; digests of what was stated."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import ANY

import h5py
import numpy as np
import pytest
from small_models import dovetail, friction_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, solve
from ewr_fenicsx.errors import OutputError
from ewr_fenicsx.laws.law_kinds import load_laws
from ewr_fenicsx.response.solution_store import fingerprint, read_records, restore, strip, write_records
from ewr_fenicsx.whole_files import open_file, replace_file

LAWS = ContactLaws(friction=0.3)


@pytest.mark.parametrize("closure", ["spring", np.full(6, 1e-9)])
def test_records_bring_the_closure_back(closure):
    """Of a problem that an accuracy chose it for."""
    problem = ContactProblem(dovetail(), LAWS, 600.0)
    solution = solve(replace(problem, closure=closure, rho_tangential=np.full(6, 1e-5)))
    back = restore(problem, strip(solution))
    np.testing.assert_array_equal(back.problem.closure, closure)
    np.testing.assert_array_equal(
        back.history("admissible_friction_force"), solution.history("admissible_friction_force")
    )


def test_records_know_which_harmonics_were_left_out():
    laws = ContactLaws("prescribed", normal_force=1.0, friction=0.3)
    solution = solve(ContactProblem(friction_oscillator(), laws, 0.12))
    back = restore(solution.problem, strip(solution))
    assert (back.left_out, back.why_left_out) == (solution.left_out, solution.why_left_out) == ((0, 2, 4), ANY)
    assert back.why_left_out


@pytest.mark.parametrize("damage, why", [("lost", "damaged: .*forces"), ("nan", "damaged: .*not finite")])
def test_a_file_of_damaged_solutions_is_named(damage, why, tmp_path):
    """Readable as HDF5: what was not a number went into a run, which then failed far from there."""
    with replace_file(tmp_path / "block.h5") as file:
        write_records(file, [strip(solve(ContactProblem(dovetail(), LAWS, 600.0)))])
    with h5py.File(tmp_path / "block.h5", "r+") as file:
        if damage == "nan":
            file["forces"][0, 1, 2] = np.nan
        else:
            del file["forces"]
    told = rf"block\.h5 cannot be read: it is {why}.*; give another place"
    with pytest.raises(OutputError, match=told), open_file(tmp_path / "block.h5") as file:
        read_records(file)


def test_a_file_with_a_wrong_bit_is_not_read(tmp_path):
    """HDF5 reads other numbers then, or never comes to an end."""
    with replace_file(tmp_path / "block.h5") as file:
        file["forces"] = np.arange(100.0)
    whole = (tmp_path / "block.h5").read_bytes()
    for place in range(0, len(whole) - 60, 97):
        damaged = bytearray(whole)
        damaged[place] ^= 4
        (tmp_path / "block.h5").write_bytes(damaged)
        with pytest.raises(OutputError, match="it is damaged; give another place"), open_file(tmp_path / "block.h5"):
            pass
    with replace_file(tmp_path / "block.h5") as file:
        file["forces"] = np.arange(100.0)
    with h5py.File(tmp_path / "block.h5", "r+") as file:
        file["notes"] = np.arange(1000.0)  # of the user's own
    with open_file(tmp_path / "block.h5") as file:
        np.testing.assert_array_equal(file["forces"][()], np.arange(100.0))


def test_fingerprints_tell_problems_apart():
    problem = ContactProblem(dovetail(), LAWS, 600.0)
    assert fingerprint(problem) == fingerprint(ContactProblem(dovetail(), replace(LAWS), 600.0))
    others = [replace(problem, frequency=600.1), replace(problem, wear=np.zeros(6)), replace(problem, harmonics=6)]
    others.append(replace(problem, laws=replace(LAWS, friction=np.full(6, 0.3))))
    assert len({fingerprint(p) for p in [problem, *others]}) == 5


def test_the_type_of_a_number_and_the_order_of_loads_change_no_fingerprint():
    """A run was not gone on with where the frequency came as 600 or from an array in place of 600.0."""
    one, two = np.ones(26), np.full(26, 2.0)
    stated = ContactProblem(dovetail(), LAWS, 600.0, 5, samples=128, rho_normal=np.full(6, 1e9), load={0: one, 1: two})
    same = [
        replace(stated, frequency=600),
        replace(stated, frequency=np.float64(600)),
        replace(stated, load={1: two, 0: one}),
    ]
    same += [replace(stated, harmonics=np.int64(5)), replace(stated, samples=np.int32(128))]
    same += [replace(stated, rho_normal=np.full(6, 10**9)), replace(stated, laws=ContactLaws(friction=np.float64(0.3)))]
    assert {fingerprint(problem) for problem in same} == {fingerprint(stated)}
    assert fingerprint((1, 3, 5)) == fingerprint([1.0, 3, np.int64(5)]) == fingerprint(range(1, 7, 2))
    assert fingerprint(np.True_) == fingerprint(True) != fingerprint(1) == fingerprint(np.array(1.0))
    apart = [
        (1, 2, 3),
        ((1, 2), 3),
        ((1,), 2, 3),
        (1, 2),
        {1: 2},
        {2: 1},
        ({1: 2}, 3),
        {1: 2, 3: 4},
        "1",
        None,
        1 + 1e-16j,
        2**53,
        2**53 + 1,
    ]
    assert len({fingerprint(item) for item in apart}) == len(apart)


def test_work_under_an_own_law_is_not_gone_on_with_under_another(tmp_path):
    """The same name and parameters, but the file has been mended since."""
    written = """
from dataclasses import dataclass
from ewr_fenicsx.laws.law_kinds import LawKind, register_law

@register_law("tangential", "mended")
@dataclass(frozen=True, eq=False)
class Mended(LawKind):
    factor: float = {factor}
"""
    stated = []
    for factor in (1.0, 1.0, 2.0):
        (tmp_path / "laws.py").write_text(written.format(factor=factor))
        load_laws(tmp_path / "laws.py")
        stated.append(fingerprint(ContactLaws(tangential="mended", parameters={"factor": 3.0})))
    assert stated[0] == stated[1] != stated[2]
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "laws.py").write_text("# of the same name, in another folder")
    load_laws(tmp_path / "other" / "laws.py")
    assert fingerprint(ContactLaws(tangential="mended", parameters={"factor": 3.0})) == stated[2]
