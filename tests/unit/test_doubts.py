"""What a scene was probably not meant to be beside its mesh and its modes: lengths, loads, damping."""

from __future__ import annotations

import re

import pytest
from small_scenes import HEAD, PULL, SCENE

from ewr_fenicsx.scene.scene_sense import (
    doubt_closure,
    doubt_drag,
    doubt_frequency,
    doubt_lengths,
    doubt_modes,
    hint_at_lengths,
)
from ewr_fenicsx.scene.scene_structure import doubt_materials


@pytest.mark.parametrize(
    "text, extent, told",
    [
        ("", 41.5, "geometry: the mesh is 41.5 m long"),
        ("[geometry.parameters]\nmesh_size = 5", 0.06, "geometry.parameters.mesh_size = 5 m is longer than the mesh"),
        (
            "[loads.spin]\nkind = 'rotation'\ncentre = [0.0, -300]\nspeed = 6000",
            0.06,
            r"loads.spin.centre = \[0.0, -300.0\] lies 300 m from the origin of a mesh that is 0.06 m long",
        ),
    ],
)  # fmt: skip
def test_lengths_in_millimetres_are_doubted_beside_the_mesh(read, text, extent, told):
    (doubt,) = doubt_lengths(read(SCENE + text), extent)
    assert re.match(told, doubt) and doubt.endswith("were mm meant?")
    sound = text.replace("= 5", "= 0.005").replace("-300", "-0.3")
    assert not list(doubt_lengths(read(SCENE + sound), 0.06))


def test_materials_that_are_titanium_for_want_of_a_word_are_doubted(read):
    """Steel with the density of the default, and a bolt that was forgotten; an empty table asks for the default."""
    stated = read(SCENE + "[materials.disk]\nyoung = 210e9\n[materials.blade]\n").materials
    half, without = doubt_materials(stated, ("disk", "blade", "bolt"), False)
    assert half.startswith("materials.disk.density: missing beside young = 2.1e+11, so that it is 4430")
    assert without.startswith("materials: disk, blade have one, bolt has none and will be of Ti-6Al-4V")
    whole = read(SCENE + "[materials.disk]\nyoung = 210e9\ndensity = 7800\n[materials.blade]\n").materials
    assert not any(list(doubt_materials(given, ("disk", "blade"), True)) for given in (whole, {}))


def test_elements_that_lock_are_told(read):
    """At 0.49 frequencies of a block are a fifth too high; in plane stress its thickness gives way."""
    rubber = "[materials.pad]\nyoung = 5e7\npoisson = 0.49\ndensity = 1100\n[elasticity]\n"
    strain, stress, square = (read(SCENE + rubber + more) for more in ("plane = 'strain'", "", "degree = 2"))
    (doubt,) = doubt_materials(strain.materials, ("pad",), strain.elasticity.locks(2))
    assert doubt.startswith("materials.pad.poisson = 0.49 with elasticity.degree = 1: elements of first order are far")
    assert [stress.elasticity.locks(d) for d in (2, 3)] == [False, True]
    assert not square.elasticity.locks(3)


def test_loads_above_the_modes_kept_are_doubted(read):
    """By the highest harmonic that is loaded; where an accuracy is asked for, modes are raised anyway."""
    twice = SCENE.replace("harmonic = 1", "harmonic = 2")
    (told,) = doubt_modes(read(twice), 3, 1900.0)
    assert "excitation.frequency = 1000: the load shake acts at 2000 Hz, above the highest of 3 modes kept" in told
    assert "raise reduction.modes, or was rad/s meant (159.155 Hz)?" in told
    assert not list(doubt_modes(read(twice), 3, 2100.0)) and not list(doubt_modes(read(SCENE), 3, 1900.0))
    assert not list(doubt_modes(read(HEAD + PULL), 3, 1.0)), "nothing oscillates"
    assert not list(doubt_modes(read(twice + "[solver]\naccuracy = 0.01"), 3, 1900.0))


def test_springs_on_solids_are_told_to_do_nothing(read):
    sprung = read(SCENE + "[solver]\nclosure = 'spring'\n")
    (told,) = doubt_closure(sprung, 3)
    assert 'solver.closure = "spring" does nothing: the mesh is of solids' in told
    assert not list(doubt_closure(sprung, 2)) and not list(doubt_closure(read(SCENE), 3))


def test_frequencies_in_kilohertz_are_doubted(read):
    """Only where they would be near the first mode: a slow motion is quasi-static, as of a machine that starts."""
    (told,) = doubt_frequency(read(SCENE.replace("1000", "1.2")), 1288.0)
    assert "1.2 Hz is so far below the first full-stick mode (1288 Hz)" in told and "was 1200 Hz" in told
    for frequency in ("0.1", "5", "1000"):
        assert not list(doubt_frequency(read(SCENE.replace("1000", frequency)), 1288.0))
    assert not list(doubt_frequency(read(SCENE.replace("1000", "100")), 86e3)), "a pin in a bush turns so slowly"
    assert not list(doubt_frequency(read(HEAD + PULL), 1288.0)), "nothing oscillates"


def test_modal_damping_that_drags_floating_bodies_is_told(read):
    modal = read(SCENE + "[damping]\nkind = 'modal'\nratio = 0.01\n")
    (told,) = doubt_drag(modal, 1200.0)
    assert "a loss factor of 0.19 at 1000 Hz" in told and 'kind = "rayleigh" with alpha = 0' in told
    assert not list(doubt_drag(modal, 600.0))
    assert not list(doubt_drag(read(SCENE), 1200.0)), "alpha was asked for"


def test_parameters_in_millimetres_are_hinted_at():
    usual = {"flank_length": 8e-3, "angle": 45.0, "pairs": 10, "name": "x"}
    assert "flank_length = 10 is far above its default, 0.008" in hint_at_lengths({"flank_length": 10}, usual)
    for fits in ({"flank_length": 0.1}, {"angle": 60.0}, {"pairs": 4000}, {"name": "y"}, {"other": 9.0}):
        assert hint_at_lengths(fits, usual) == ""
