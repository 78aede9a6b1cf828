"""What pictures show: nothing over anything else, forces where they act, curves named for what they are."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.text import Text
from small_scenes import read_demo, write_blocks

from ewr_fenicsx import load_scene
from ewr_fenicsx.errors import SceneWarning
from ewr_fenicsx.output import plots, solid_plots
from ewr_fenicsx.output.cost_plots import draw_work_precision
from ewr_fenicsx.output.gathering import Cells, gather_cells
from ewr_fenicsx.output.mesh_plots import _lay_panels, draw_mesh, draw_motion, gather_mode, tell_mode
from ewr_fenicsx.runs.study import run_study
from ewr_fenicsx.solution.contact_state import SLIP, classify_contact, sample_friction_limit
from ewr_fenicsx.structure.chain import build_chain

ROOT = Path(__file__).parents[2]


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """Draw the mesh of a demo or a scene; returns its two panels."""

    def draw(name: str | Path):
        figures = []
        monkeypatch.setattr(Figure, "savefig", lambda figure, path, **more: figures.append(figure))
        draw_mesh(tmp_path / "mesh.png", build_chain(load_scene((ROOT / "demos" / name).with_suffix(".toml"))))
        FigureCanvasAgg(figures[0]).draw()
        return figures[0].axes

    return draw


@pytest.mark.parametrize("name", ["tapping_rod", "bolted_lap", "two_blocks", "dovetail"])
def test_nothing_is_printed_over_anything_else(drawn, name):
    """Legends, numbers and labels of both panels, however low or narrow they are."""
    for axes in drawn(name):
        renderer = axes.figure.canvas.get_renderer()
        numbers = [[t.get_window_extent(renderer) for t in axis.get_ticklabels() if t.get_text()]
                   for axis in (axes.xaxis, axes.yaxis)]  # fmt: skip
        for along in numbers:
            inside = [box for box in along if axes.bbox.padded(1).overlaps(box.padded(30))]
            assert len(inside) > 1
            assert not any(a.overlaps(b) for i, a in enumerate(inside) for b in inside[:i])
        legend = axes.get_legend().get_window_extent(renderer)
        assert not any(legend.overlaps(box) for along in numbers for box in along)
        assert not legend.overlaps(axes.xaxis.label.get_window_extent(renderer))


@pytest.fixture
def texts_with_dollars(monkeypatch):
    """Of each picture that is written, its texts with a dollar, and whether they are read as formulas."""
    found, write = [], Figure.savefig

    def keep(figure, path, **settings):
        write(figure, path, **settings)
        texts = figure.findobj(lambda artist: isinstance(artist, Text) and "$" in artist.get_text())
        found.append({text.get_text(): text.get_parse_math() for text in texts})

    monkeypatch.setattr(Figure, "savefig", keep)
    return found


BROKEN = r"price 5$ \frac{x$"  # a formula that matplotlib cannot read; of two dollars it would make an empty one


def test_dollars_in_titles_and_names_are_dollars(texts_with_dollars, tmp_path):
    text = read_demo("two_blocks")
    text = text.replace('"Two blocks under shaker load"', f"'{BROKEN}'").replace("[loads.shake]", f"[loads.'{BROKEN}']")
    (tmp_path / "scene.toml").write_text(text)
    scene = load_scene(tmp_path / "scene.toml")
    assert scene.title == BROKEN and BROKEN in scene.loads
    draw_mesh(tmp_path / "mesh.png", build_chain(scene))
    series = {f"rms_{BROKEN} [mm]": np.array([1.0, 2.0])}
    plots.draw_curves(tmp_path / "one.png", "cycles", np.array([0.0, 1.0]), series)
    plots.draw_curves(tmp_path / "two.png", "cycles", np.array([0.0, 1.0]), {"rms [mm]": np.array([3.0, 4.0])} | series)
    mesh, one, two = texts_with_dollars
    assert set(mesh.values()) == set(one.values()) == set(two.values()) == {False}
    assert len(mesh) == 2 and len(one) == len(two) == 1


def test_dollars_do_not_keep_numbers_along_axes_from_being_formulas(texts_with_dollars, tmp_path):
    rows = [
        {"knob": "N", "value": n, "converged": True, "seconds": float(n), "errors": {"output": 10.0**-n}}
        for n in (1, 2, 5)
    ]
    draw_work_precision(tmp_path / "cost.png", rows, {"output": f"of {BROKEN}"}, BROKEN)
    (found,) = texts_with_dollars
    plain = {text for text, formula in found.items() if not formula}
    assert plain == {BROKEN, f"of {BROKEN}"} and r"$\mathdefault{10^{-2}}$" in found


def list_arrows(axes) -> list[tuple[np.ndarray, np.ndarray]]:
    """Tail and head of each load [mm]."""
    return [(np.array(text.xyann), np.array(text.xy)) for text in axes.texts if text.arrow_patch]


def test_forces_that_press_end_on_the_body(drawn):
    """The washers press the lap of two beams of 6 mm; a force that shakes goes both ways."""
    (above, on_top), (below, on_bottom), (one, other) = list_arrows(drawn("bolted_lap")[0])
    np.testing.assert_allclose([on_top, on_bottom], [[0, 6], [0, -6]], atol=1e-6)
    assert above[0] == pytest.approx(0) and above[1] > 20
    assert below[0] == pytest.approx(0) and below[1] < -20
    np.testing.assert_allclose((one + other) / 2, [25, 3], atol=1e-6)


def test_forces_that_pull_begin_on_the_body(drawn):
    (tail, head), *_ = list_arrows(drawn("blade_root")[0])
    assert head[1] > tail[1] + 10 and tail[1] > 270, "upwards from the tip"


def test_forces_are_told_apart_by_colour_and_length(drawn, tmp_path):
    """A push and two shakers, of 250 N and of a tenth of that."""
    text = read_demo("two_blocks")
    text += '[loads.hum]\nboundary = "top"\nforce = [15.0, 20.0]\nharmonic = 2\n'
    (tmp_path / "scene.toml").write_text(text)
    axes = drawn(tmp_path / "scene.toml")[0]
    push, shake, hum = list_arrows(axes)
    long, short = (np.linalg.norm(head - tail) for tail, head in (shake, hum))
    assert np.linalg.norm(push[1] - push[0]) == pytest.approx(long / 2), "one way, and there and back"
    assert short / long == pytest.approx(0.4 + 0.6 * 0.1)
    colours = [to_hex(text.arrow_patch.get_edgecolor()) for text in axes.texts if text.arrow_patch]
    legend = axes.get_legend()
    entries = zip(legend.get_texts(), legend.get_lines(), strict=True)
    told = {text.get_text().split(":")[0]: line.get_color() for text, line in entries}
    assert len(set(colours)) == 3 and colours == [told[name] for name in ("press", "shake", "hum")]


def test_forces_on_one_line_do_not_cover_each_other(drawn, tmp_path):
    """The push and the hum were under the shaker, which is as long or longer and came last."""
    text = read_demo("two_blocks").partition("[loads")[0]
    for name, size, harmonic in (("hum", 20.0, 2), ("press", -4000.0, 0), ("shake", 250.0, 1)):
        text += f'[loads.{name}]\nboundary = "top"\nforce = [0.0, {size}]\nharmonic = {harmonic}\n'
    text += '[contact]\nbody_a = "upper"\nbody_b = "lower"\n[excitation]\nfrequency = 1000.0\n'
    (tmp_path / "scene.toml").write_text(text)
    axes = drawn(tmp_path / "scene.toml")[0]
    pixels = np.asarray(axes.figure.canvas.buffer_rgba())[::-1, :, :3]
    hum, press, shake = list_arrows(axes)
    colours = [to_hex(text.arrow_patch.get_edgecolor()) for text in axes.texts if text.arrow_patch]
    assert len(set(colours)) == 3
    # on shafts, away from heads: the push above the body, the others below
    below = lambda arrow, share: share * min(arrow, key=lambda end: end[1]) + (1 - share) * np.mean(arrow, axis=0)  # noqa: E731
    for point, colour in zip((below(hum, 0.3), np.mean(press, axis=0), below(shake, 0.7)), colours, strict=True):
        column, row = axes.transData.transform(point).round().astype(int)
        assert to_hex(pixels[row, column] / 255) == colour


def test_a_mesh_that_is_drawn_closed_says_so_where_the_scene_has_a_gap(drawn):
    assert drawn("tapping_rod")[1].get_title() == "joint: 5 pairs, drawn without initial gaps"
    assert drawn("shrouded_ring")[1].get_title() == "joint: 8 pairs, drawn without interference"
    assert drawn("two_blocks")[1].get_title() == "joint: 9 pairs"


def test_pairs_lie_on_the_edges_of_the_mesh(drawn):
    for axes in drawn("two_blocks"):
        (outline,) = (drawing for drawing in axes.collections if isinstance(drawing, LineCollection))
        corners = np.concatenate(outline.get_segments())
        points = np.concatenate([np.transpose(line.get_data()) for line in axes.lines if line.get_marker() == "o"])
        assert np.linalg.norm(points[:, None] - corners, axis=2).min(axis=1).max() < 1e-6


def test_pairs_are_drawn_in_the_units_that_the_axes_name(tmp_path, monkeypatch):
    (tmp_path / "scene.toml").write_text(write_blocks(shake=200.0))
    study = run_study(build_chain(load_scene(tmp_path / "scene.toml")))
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **more: figures.append(figure))
    plots.draw_histories(tmp_path / "histories.png", study.chain.interface, study.solution)
    plots.draw_contact_sets(tmp_path / "sets.png", study.chain.interface, study.solution)
    histories, sets = (figure.axes[:-1] for figure in figures)
    normal, rubbing, gap, slip, velocity = map(study.solution.history, plots.LEAST)
    limit = sample_friction_limit(study.solution, plots.SAMPLES)
    shown = limit > 0.05 * limit.max()
    assert gap.max() > 1e-6 and velocity.max() > 0.01, "pairs open and slip"
    for axes, values in zip(histories, (normal, rubbing, 1e6 * gap, 1e6 * (slip - slip.mean(axis=0))), strict=True):
        np.testing.assert_allclose(np.transpose([line.get_ydata() for line in axes.lines[:-1]]), values, atol=1e-9)
    pressing, sliding = (np.concatenate([line.get_data() for line in axes.lines[1:]], axis=1) for axes in sets)
    np.testing.assert_allclose(pressing, [1e6 * gap.T.ravel(), normal.T.ravel()], atol=1e-9)
    share = rubbing.T[shown.T] / limit.T[shown.T]
    np.testing.assert_allclose(sliding, [1e3 * velocity.T[shown.T], share], atol=1e-9)


def test_what_is_not_drawn_is_no_scale(tmp_path, monkeypatch):
    """Open pairs may be far faster than those that rub, as here where all that are fast are taken for open."""
    (tmp_path / "scene.toml").write_text(write_blocks(shake=200.0))
    study, figures = run_study(build_chain(load_scene(tmp_path / "scene.toml"))), []
    speed = 1e3 * np.abs(study.solution.history("slip_velocity", plots.SAMPLES))
    rubs = speed < 0.3 * speed.max()
    monkeypatch.setattr(plots, "sample_friction_limit", lambda *_: np.where(rubs, 1.0, 0.0))
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **more: figures.append(figure))
    plots.draw_contact_sets(tmp_path / "sets.png", study.chain.interface, study.solution)
    assert speed[rubs].max() < figures[0].axes[1].get_xlim()[1] < 1.3 * speed[rubs].max()


def test_numbers_stay_apart_where_nothing_opens_or_moves(tmp_path, monkeypatch):
    """Axes are then a thousandth of a micrometre wide, and their numbers long."""
    text = read_demo("blade_root")
    text = text.partition("[loads.tip_shake]")[0]  # at rest
    (tmp_path / "scene.toml").write_text(text)
    study = run_study(build_chain(load_scene(tmp_path / "scene.toml")))
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **more: figures.append(figure))
    plots.draw_contact_sets(tmp_path / "sets.png", study.chain.interface, study.solution)
    FigureCanvasAgg(figures[0]).draw()
    for axes in figures[0].axes[:8]:
        low, high = axes.get_xlim()
        assert high - low < 0.01
        boxes = [t.get_window_extent() for t in axes.get_xticklabels() if low <= t.get_position()[0] <= high]
        assert len(boxes) > 1 and not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


def test_where_no_pair_touches_rounding_is_not_drawn_large(tmp_path, monkeypatch):
    """The solve may leave open pairs with forces of 1e-17 N, here put in: one flank gapes, the other is glued."""
    away = "[flanks.left]\ninitial_gap = 5e-4", "[flanks.right]\nnormal = 'bonded'\ntangential = 'bonded'"
    (tmp_path / "scene.toml").write_text(write_blocks(*away, source=ROOT / "geometry" / "dovetail.py"))
    study, figures = run_study(build_chain(load_scene(tmp_path / "scene.toml"))), []
    solution, exact = study.solution, study.solution.history
    rounded = lambda self, name, samples: exact(name, samples) + 1e-17 * (name == "normal_force")  # noqa: E731
    monkeypatch.setattr(type(solution), "history", rounded)
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **more: figures.append(figure))
    plots.draw_contact_sets(tmp_path / "sets.png", study.chain.interface, solution)
    assert figures[0].axes[0].get_ylim()[1] > plots.LEAST["normal_force"]


def test_flanks_are_not_held_against_laws_that_they_do_not_have(tmp_path, monkeypatch):
    """Under a given normal force bodies overlap by micrometres: that is no violation, and no scale for other gaps."""
    text = read_demo("blade_root")
    text += '[flanks.bottom_right]\nnormal = "prescribed"\nnormal_force = 80.0\n'
    (tmp_path / "scene.toml").write_text(text + '[flanks.top_right]\ntangential = "frictionless"\n')
    study = run_study(build_chain(load_scene(tmp_path / "scene.toml")))
    interface, solution, figures = study.chain.interface, study.solution, []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **more: figures.append(figure))
    plots.draw_contact_sets(tmp_path / "sets.png", interface, solution)
    plots.draw_histories(tmp_path / "histories.png", interface, solution)
    sets, histories = (np.array(figure.axes[:-1]).reshape(-1, 4) for figure in figures)
    given, smooth = (interface.flanks.index(name) for name in ("bottom_right", "top_right"))
    empty = np.zeros((2, 4), dtype=bool)
    empty[0, given] = empty[1, smooth] = True
    np.testing.assert_array_equal([[not axes.lines for axes in row] for row in sets], empty)
    assert solution.history("gap")[:, interface.flank_of_pair == given].min() < -1e-6
    assert sets[0, 0].get_xlim()[0] > -1.0 and histories[2, 0].get_ylim()[0] > -1.0, "in micrometres"


@pytest.mark.parametrize("scene, panels", [("two_blocks", ["gap [µm]"]), ("friction_damped_beam", [])])
def test_a_law_of_one_s_own_is_not_held_against_coulomb_s_set(scene, panels, tmp_path, monkeypatch):
    """It rubs, but by no multiple of the normal force: nothing would be in the panel but the set."""
    recipe = (ROOT / "docs" / "adding_a_law.md").read_text(encoding="utf-8")
    code = re.search(r"```python\n(.*?)```", recipe, re.DOTALL).group(1)
    (tmp_path / "slider.py").write_text(code.replace('"jenkins"', f'"slider_{scene}"'))
    text = read_demo(scene)
    own = f'law_files = ["slider.py"]\ntangential = "slider_{scene}"\nparameters = {{ spring = 1e7, limit = 0.1 }}'
    text = re.sub("(?m)^frequency = .*", "frequency = 215.0", re.sub("(?m)^friction = .*", own, text))
    (tmp_path / "scene.toml").write_text(text)
    study, drawn = run_study(build_chain(load_scene(tmp_path / "scene.toml"))), []
    assert np.any(classify_contact(study.solution, 64) == SLIP)
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **more: drawn.extend(figure.axes[:-1]))
    plots.draw_contact_sets(tmp_path / "sets.png", study.chain.interface, study.solution)
    assert [axes.get_xlabel() for axes in drawn] == panels


@pytest.fixture(scope="module")
def worn(tmp_path_factory):
    """Two cycles of wear of the dovetail."""
    scene = tmp_path_factory.mktemp("worn") / "scene.toml"
    text = read_demo("dovetail")
    scene.write_text(text.replace("cycles = 2000", "cycles = 2"))
    return run_study(build_chain(load_scene(scene)))


def test_pictures_of_a_worn_joint_say_so(worn, tmp_path, monkeypatch):
    """They are those of the last cycle, unlike the ones of the same scene without wear."""
    titles = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **more: titles.append(figure._suptitle.get_text()))
    for draw in (plots.draw_histories, plots.draw_contact_sets):
        draw(tmp_path / "picture.png", worn.chain.interface, worn.solution)
    top, depth = worn.solution.orders[-1], worn.solution.problem.wear.max()
    assert set(titles) == {f"1400 Hz, harmonics 0 to {top}, worn by up to {1e6 * depth:.3g} µm"}


def stand_a_rod() -> Cells:
    """One cell, ten times as high as wide, pushed sideways."""
    corners = np.array([[[0.0, 0.0], [0.02, 0.0], [0.02, 0.2], [0.0, 0.2]]])
    return Cells(corners, np.tile([0.01, 0.0], (1, 4, 1)), np.array([1]))


def test_no_title_of_a_narrow_picture_is_cut_off(tmp_path, monkeypatch):
    """A blade is slender, and a joint of one flank takes one column."""
    (tmp_path / "scene.toml").write_text(write_blocks(solver="harmonics = [0, 1, 2, 3, 5, 7, 9, 11, 13, 15, 17, 19]"))
    study, figures = run_study(build_chain(load_scene(tmp_path / "scene.toml"))), []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **more: figures.append(figure))
    draw_motion(tmp_path / "mode.png", stand_a_rod(), "full-stick mode 1 in a wave of 3 nodal diameters: 1450.0 Hz")
    for draw in (plots.draw_histories, plots.draw_contact_sets):
        draw(tmp_path / "picture.png", study.chain.interface, study.solution)
    for figure in figures:
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        title = figure._suptitle.get_window_extent(canvas.get_renderer())
        assert figure.bbox.x0 <= title.x0 and title.x1 <= figure.bbox.x1
        assert title.y0 > max(axes.get_window_extent().y1 for axes in figure.axes)


def test_flanks_of_a_large_fir_tree_have_colours_of_their_own():
    assert len(set(plots.FLANK_COLOURS)) >= 10


def test_a_curve_without_outputs_shows_something_that_moves(tmp_path, monkeypatch):
    """Nothing slides where all is bonded."""
    text = read_demo("two_blocks")
    text = text.partition("[outputs")[0] + '[contact]\nbody_a = "upper"\nbody_b = "lower"\n'
    text += 'normal = "bonded"\ntangential = "bonded"\n[excitation]\nfrequency = [900.0, 1000.0]\n'
    (tmp_path / "scene.toml").write_text(text)
    shown = {}
    monkeypatch.setattr(plots, "draw_curves", lambda path, across, x, series, *more: shown.update(series))
    with pytest.warns(SceneWarning, match="there are no outputs"):
        scene = load_scene(tmp_path / "scene.toml")
    study = run_study(build_chain(scene))
    study.write(tmp_path)
    assert list(shown) == ["excitation_work [J]"] and (shown["excitation_work [J]"] > 0).all()


@pytest.mark.parametrize(
    "series, label, told",
    [
        ({"rms_tip [mm]": [1.0, 2.0]}, "rms_tip [mm]", False),
        ({"mean [µm]": [1.0, 2.0], "deepest [µm]": [2.0, 3.0]}, "[µm]", True),
        ({"depth [µm]": [1.0, 2.0], "work [J]": [2.0, 3.0]}, "", True),
    ],
)
def test_the_unit_of_curves_stands_at_their_axis(monkeypatch, tmp_path, series, label, told):
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **more: figures.append(figure))
    plots.draw_curves(tmp_path / "curves.png", "frequency [Hz]", np.array([1.0, 2.0]), series)
    axes = figures[0].axes[0]
    assert axes.get_ylabel() == label and (axes.get_legend() is not None) == told


@pytest.mark.parametrize("height", [2.0, 0.0])
def test_a_flat_curve_does_not_lie_on_the_frame(monkeypatch, tmp_path, height):
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **more: figures.append(figure))
    plots.draw_curves(tmp_path / "curves.png", "cycles", np.array([0.0, 1.0]), {"rms [mm]": np.full(2, height)})
    low, high = figures[0].axes[0].get_ylim()
    assert low == 0.0 and high > 1.04 * height and high > 0


def test_no_matplotlibrc_changes_a_picture(tmp_path):
    for name, theirs in {"usual.png": {}, "theirs.png": {"text.usetex": True}}.items():  # which takes LaTeX
        rc_context(theirs)(plots.draw_curves)(tmp_path / name, "share [%]", np.arange(2.0), {"rms": np.arange(2.0)})
    assert (tmp_path / "usual.png").read_bytes() == (tmp_path / "theirs.png").read_bytes()


def test_curves_that_coincide_are_one_under_both_names(monkeypatch, tmp_path):
    """As of flanks that are each other's mirror image, where the last would hide all others."""
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **more: figures.append(figure))
    series = {"left": [1.0, 2.0], "right": [1.0, 2.0001], "deepest": [1.0, 2.1]}
    plots.draw_curves(tmp_path / "curves.png", "cycles", np.array([0.0, 1.0]), series)
    told = [text.get_text() for text in figures[0].axes[0].get_legend().get_texts()]
    assert told == ["left\n= right", "deepest"]


def test_wear_is_drawn_by_its_mean_and_its_deepest(worn, tmp_path, monkeypatch):
    shown = {}
    monkeypatch.setattr(plots, "draw_curves", lambda path, across, x, series: shown.update(series))
    worn.write(tmp_path)
    assert list(shown) == ["mean depth of left [µm]", "mean depth of right [µm]", "deepest pair [µm]"]
    depth = 1e6 * worn.solution.problem.wear
    assert shown["deepest pair [µm]"][-1] == pytest.approx(depth.max())
    left = worn.chain.interface.flank_of_pair == 0
    mean = np.average(depth[left], weights=worn.chain.interface.area[left])
    assert shown["mean depth of left [µm]"][-1] == pytest.approx(mean), "end pairs have half the area of the others"
    assert shown["mean depth of left [µm]"][-1] < shown["deepest pair [µm]"][-1]


@pytest.mark.parametrize(("wide", "high"), [(8.0, 5.0), (8.0, 0.0), (3.0, 8.0)])
def test_normals_at_the_edge_of_the_joint_have_room(wide, high):
    """Those of a floor were cut off, arrowheads included."""
    joint = 1e-3 * np.array([[0.0, 0.0], [wide, high]])
    cells = SimpleNamespace(corners=1e-3 * np.array([[[-20.0, -5.0], [30.0, 10.0]]]))
    _, _, axes = _lay_panels(cells, SimpleNamespace(position=joint))
    arrow = 0.11 * max(wide, high)
    for (low, top), reach in ((axes.get_xlim(), wide), (axes.get_ylim(), high)):
        assert low < -arrow and top > reach + arrow


@pytest.fixture(scope="module")
def solid(tmp_path_factory):
    """A dovetail of hexahedra, pulled and shaken askew."""
    scene = tmp_path_factory.mktemp("solid") / "scene.toml"
    entries = (
        f'[geometry]\nsource = "{ROOT / "geometry" / "extruded.py"}"',
        'parameters = { profile = "dovetail", pairs = 4, layers = 2, mesh_size = 5e-3 }',
        '[loads.pull]\nboundary = "tip"\nforce = [0.0, 4000.0, 0.0]',
        '[loads.shake]\nboundary = "tip"\nforce = [30.0, 0.0, 40.0]\nharmonic = 1',
        "[excitation]\nfrequency = 1000.0",
    )
    scene.write_text("\n".join(entries))
    return build_chain(load_scene(scene, warn=False))


def draw_solid(monkeypatch, draw, path, chain):
    """The figure that a picture of a solid is made of; warnings are errors."""
    figures, write = [], Figure.savefig
    monkeypatch.setattr(
        Figure, "savefig", lambda figure, *given, **more: (figures.append(figure), write(figure, *given, **more))
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        draw(path, chain)
    assert path.stat().st_size > 10_000
    return figures[0]


def test_a_solid_is_drawn_with_its_joint_and_loads(solid, monkeypatch, tmp_path):
    figure = draw_solid(monkeypatch, solid_plots.draw_mesh, tmp_path / "mesh.png", solid)
    whole, joint = figure.axes
    told = [[text.get_text() for text in axes.get_legend().get_texts()] for axes in (whole, joint)]
    assert told[0] == ["held: clamp", "pull: 4000 N, static", "shake: 50 N at 1000 Hz"]
    assert told[1] == ["left, 12 pairs", "right, 12 pairs", "outward normal of the blade"]
    assert joint.get_title() == "joint: 24 pairs"
    dots = [line for line in joint.lines if line.get_marker() == "o"]
    places = np.concatenate([np.transpose(line.get_data_3d()) for line in dots])
    np.testing.assert_allclose(places[:, [1, 2, 0]], 1e3 * solid.interface.position, err_msg="y upwards")
    (pull, shake), _ = ([arrow for arrow in list_arrows(axes) if np.ptp(arrow) > 0] for axes in (whole, joint))
    assert pull[1][1] > pull[0][1] and pull[1][0] == pytest.approx(pull[0][0]), "upwards"
    assert shake[1][0] > shake[0][0]


@pytest.mark.parametrize("title", ["", "A blade that somebody had much to tell of, with all that is known: " * 2])
def test_nothing_is_printed_over_anything_else_of_a_solid(solid, monkeypatch, tmp_path, title):
    """Numbers, names of axes, titles and legends."""
    named = replace(solid, scene=solid.scene.model_copy(update={"title": title}))
    figure = draw_solid(monkeypatch, solid_plots.draw_mesh, tmp_path / "mesh.png", named)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    boxes = {figure._suptitle: figure._suptitle.get_window_extent(canvas.get_renderer())}
    for axes in figure.axes:
        shown = [axes.title, axes.get_legend(), *(text for text in axes.texts if text.get_text())]
        assert sum(isinstance(text, Text) and "[mm]" in text.get_text() for text in shown) == 3
        boxes |= {text: text.get_window_extent(canvas.get_renderer()) for text in shown}
    everywhere = figure.bbox
    for k, (text, box) in enumerate(boxes.items()):
        assert everywhere.x0 <= box.x0 and box.x1 <= everywhere.x1 and everywhere.y0 <= box.y0
        # names of axes stand askew, and so do not fill their boxes
        over = [other for other, there in list(boxes.items())[:k] if box.overlaps(there)]
        assert not [other for other in over if not {getattr(t, "_rotation", 0) for t in (text, other)} - {0, 90}]


def test_the_mode_of_a_solid_is_drawn_over_its_outline(solid, monkeypatch, tmp_path):
    draw_mode = lambda path, chain: solid_plots.draw_motion(path, gather_mode(chain), tell_mode(chain))  # noqa: E731
    figure = draw_solid(monkeypatch, draw_mode, tmp_path / "mode.png", solid)
    axes, bar = figure.axes
    assert figure._suptitle.get_text() == f"full-stick mode 1: {solid.reduction.full_stick.frequency[0]:.1f} Hz"
    assert bar.get_ylabel() == "displacement / its largest value"
    outline, faces = axes.collections
    cells = gather_cells(solid)
    assert len(outline.get_segments()) == len(cells.outline())
    assert len(faces.get_facecolor()) == len(cells.body) and len(np.unique(faces.get_facecolor(), axis=0)) > 20
