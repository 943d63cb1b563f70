"""Pictures show what they should, return Matplotlib's objects, need no screen, and refuse what does not fit."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from control_problems import plane
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.solution.plotting import COLORS

pytestmark = pytest.mark.usefixtures("headless")


def swing(parameters=None):
    def lagrangian(t, x, v, p=(1.5,)):
        return p[0] * v[0] ** 2 / 2 * (1 + x[0] ** 2) + ca.cos(x[0])

    problem = cg.BoundaryProblem(lagrangian, (0.0, 2.0), [0.2], [1.0], parameters=parameters)
    return cg.transcribe(problem, cg.Galerkin(4), 6)


def planar(duration=1.0):
    problem = cg.BoundaryProblem(lambda t, x, v: ca.dot(v, v) / 2 - x[1], (0.0, duration), [0.0, 0.0], [1.0, 0.5])
    return cg.transcribe(problem, cg.Galerkin(3), 5)


def test_path_is_drawn_with_names_units_and_joints():
    path = planar().solve()
    axes = path.plot(labels=["width in m", "height in m"], time="t in s")
    assert (axes.get_xlabel(), [text.get_text() for text in axes.get_legend().get_texts()]) == (
        "t in s",
        ["width in m", "height in m"],
    )
    assert axes.get_ylabel() == ""  # the legend names them
    lines = axes.get_lines()
    for i in (0, 1):
        np.testing.assert_array_equal(lines[2 * i].get_ydata(), path(lines[2 * i].get_xdata())[i])
        np.testing.assert_array_equal(lines[2 * i + 1].get_xydata(), np.stack((path.t, path.x[i]), axis=1))
        assert lines[2 * i].get_color() == lines[2 * i + 1].get_color() == COLORS[i]


@pytest.mark.slow
def test_the_names_of_many_components_hide_no_line():
    problem = cg.BoundaryProblem(lambda t, x, v: ca.dot(v, v) / 2, (0, 1), [0.0] * 4, [1.0, 2.0, 3.0, 4.0])
    axes = cg.solve(problem, cg.Galerkin(2), 4).plot()
    axes.figure.canvas.draw()
    assert axes.get_legend().get_window_extent().x0 >= axes.get_window_extent().x1


def test_one_component_names_its_axis():
    assert swing().solve().plot(labels=["angle in rad"]).get_ylabel() == "angle in rad"
    assert swing().solve().plot().get_ylabel() == "x[0]"


@pytest.mark.parametrize(
    "labels", [["one"], ["one", "two", "three"], "xy", 2, {"x", "y"}, {"x": "m", "y": "m"}, ["x", 1]]
)
def test_labels_that_are_not_one_a_component_are_refused(labels):
    with pytest.raises(ValueError, match=r"labels of x must be 2 names, one per component, got"):
        planar().solve().plot(labels=labels)


@pytest.mark.slow
def test_a_long_title_stays_inside_of_the_figure():
    axes = swing().solve().plot()
    axes.set_title("Degree 10 on 200 intervals: action -2.93331e-11, Morse index 12", wrap=axes.title.get_wrap())
    axes.figure.draw_without_rendering()
    assert axes.title.get_window_extent().x1 < axes.figure.bbox.x1


@pytest.fixture
def driven():
    """A mass in the plane, pushed by two controls."""
    return cg.solve(plane(), cg.Galerkin(3), 2)


def test_controls_and_costate_carry_names_and_units_too(driven):
    names = [[f"{what} {axis} in {unit}" for axis in "xy"] for what, unit in (("to", "m"), ("push", "N"), ("λ", "N"))]
    top = driven.plot(labels=names[0], time="t in s", control_labels=names[1], costate_labels=names[2])
    panels = top.figure.axes
    assert [[text.get_text() for text in axes.get_legend().get_texts()] for axes in panels] == names
    assert [axes.get_ylabel() for axes in panels] == ["", "", ""]
    assert [axes.get_xlabel() for axes in panels] == ["", "", "t in s"]


@pytest.mark.parametrize(("which", "name"), [("labels", "x"), ("control_labels", "u"), ("costate_labels", "λ")])
def test_labels_of_controls_and_costate_that_do_not_fit_are_refused(driven, which, name):
    with pytest.raises(ValueError, match=rf"labels of {name} must be 2 names, one per component, got \['one'\]"):
        driven.plot(**{which: ["one"]})


@pytest.mark.parametrize("parameters", [None, [1.5]])
def test_phase_line_passes_the_joints_with_their_momenta(parameters):
    path = swing(parameters).solve()
    line, joints, start = path.plot_phase().get_lines()
    np.testing.assert_array_equal(joints.get_xydata(), np.stack((path.x[0], path.momentum[0]), axis=1))
    np.testing.assert_array_equal(start.get_xydata(), [[path.x[0, 0], path.momentum[0, 0]]])
    x, p = line.get_xydata().T
    energy = p**2 / (2 * 1.5 * (1 + x**2)) - np.cos(x)
    # degree 4 on 6 intervals: the velocity of the polynomial is good to 1e-4 between the joints
    np.testing.assert_allclose(energy, path.energy[0], rtol=0, atol=1e-3)


def test_a_line_follows_every_oscillation_of_a_long_path():
    motion = cg.InitialProblem(lambda t, x, v: (v[0] ** 2 - x[0] ** 2) / 2, (0, 400), [1.0], velocity=[0.0])
    x, p = cg.solve(motion, cg.Galerkin(16), 100).plot_phase().lines[0].get_xydata().T
    halfway = np.hypot(x[1:] + x[:-1], p[1:] + p[:-1]) / 2
    assert np.min(halfway) > 0.99  # the circle, and not chords across it


def test_phase_portraits_of_several_paths_share_axes_in_different_colors():
    path = planar().solve()
    axes = path.plot_phase(0)
    assert path.plot_phase(1, axes, ("height in m", "momentum in kg m/s")) is axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("height in m", "momentum in kg m/s")
    assert [axes.get_lines()[i].get_color() for i in (0, 3)] == list(COLORS[:2])


def test_colors_are_those_of_the_package_on_the_users_axes_too():
    import matplotlib.pyplot as plt

    axes = plt.subplots()[1]
    assert planar().solve().plot_phase(0, axes).get_lines()[0].get_color() == COLORS[0]


@pytest.mark.parametrize("component", [2, -1, 0.5, "x"])
def test_a_component_that_is_not_there_is_refused(component):
    with pytest.raises(ValueError, match=f"component must be a whole number from 0 to 1, got {component!r}"):
        planar().solve().plot_phase(component)


def test_a_way_through_the_plane_has_equal_axes_and_all_joints():
    path = planar().solve()
    axes = path.plot_plane((1, 0), labels=np.array(["height in m", "width in m"]))
    line, joints = axes.get_lines()
    np.testing.assert_array_equal(joints.get_xydata(), path.x[[1, 0]].T)
    assert axes.get_aspect() == 1.0
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("height in m", "width in m")
    height, width = line.get_xydata().T
    np.testing.assert_allclose(
        height, width / 2 + width * (1 - width) / 2, atol=1e-12
    )  # a throw, one wide in unit time


@pytest.mark.parametrize(
    ("draw", "kind", "message"),
    [
        (
            lambda path: path.plot_phase(labels=("x",)),
            ValueError,
            r"labels of x and p must be 2 names.*got \('x',\)",
        ),
        (lambda _: swing().solve().plot_plane(), ValueError, r"draws two components .* only x\[0\]: .* by plot_phase"),
        (lambda path: path.plot_plane(labels=("x",)), ValueError, r"labels of x must be 2 names.*got \('x',\)"),
        (lambda path: path.plot(["x", "y"]), TypeError, r"axes must be Matplotlib axes, got \['x', 'y'\]"),
        (lambda path: path.animate(rods, seconds=0), ValueError, "seconds must be a positive number, got 0"),
        (lambda path: path.animate(rods, seconds=-1.0), ValueError, r"seconds must be a positive number, got -1\.0"),
        (lambda path: path.animate(3), TypeError, "points must be a callable of positions, got 3"),
        (lambda path: path.plot_poses(rods, count=0), ValueError, "count must be at least 1, got 0"),
        (lambda path: path.plot_poses(rods, apart="1"), ValueError, "apart must be a finite number, got '1'"),
    ],
)
def test_what_cannot_be_drawn_is_refused(draw, kind, message):
    with pytest.raises(kind, match=message):
        draw(planar().solve())


@pytest.mark.parametrize("components", [(0, 2), (0,), (0, 1, 0), (0.0, 1.0), (-1, 0), 1, None])
def test_components_that_span_no_plane_are_refused(components):
    with pytest.raises(ValueError, match="components must be two numbers from 0 to 1, got"):
        planar().solve().plot_plane(components)


@pytest.mark.slow
def test_poses_are_those_of_the_path_and_a_strip_moves_them_apart():
    path = planar().solve()
    trail, *poses = path.plot_poses(rods, count=3).get_lines()
    assert len(trail.get_xdata()) > 50
    for pose, t in zip(poses, (0.0, 0.5, 1.0), strict=True):
        np.testing.assert_allclose(pose.get_xydata(), [[0, 0], path(t)], atol=1e-15)
    strip = path.plot_poses(rods, count=3, apart=2.0).get_lines()[1:]
    np.testing.assert_allclose([pose.get_xydata()[0] for pose in strip], [[0, 0], [2, 0], [4, 0]])


@pytest.mark.slow
def test_a_branch_is_drawn_by_morse_index_with_its_folds():
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * ca.exp(x[0]), (0, 1), [0.0], [0.0], parameters=[3.0]
    )
    branch = cg.continuation(problem, [4.0], intervals=4)
    *parts, fold = branch.plot(lambda path: path(0.5)[0]).get_lines()
    assert [part.get_label() for part in parts] == ["Morse index 0", "Morse index 1"]
    assert sum(len(part.get_xdata()) for part in parts) == len(branch.trajectories)
    np.testing.assert_allclose(fold.get_xydata(), [[3.5138307, 1.1868]], rtol=1e-4)
    with pytest.raises(ValueError, match="parameter must be a whole number from 0 to 0, got 1"):
        branch.plot(lambda path: path(0.5)[0], parameter=1)


def test_no_part_of_a_branch_is_left_out_for_want_of_a_color():
    paths = tuple(SimpleNamespace(morse_index=i, parameters=(float(i),)) for i in range(9))
    axes = cg.Branch(paths, (), (), "the target").plot(lambda path: 1.0)
    assert [line.get_label() for line in axes.get_lines()] == [f"Morse index {i}" for i in range(9)]


@pytest.mark.slow
def test_stable_branches_are_full_lines_and_branch_points_circles():
    rod = cg.BoundaryProblem(
        lambda s, x, v, p: v[0] ** 2 / 2 + p[0] * ca.cos(x[0]), (0, 1), [0.0], [0.0], parameters=[5.0]
    )
    axes = cg.continuation(rod, [20.0], cg.Galerkin(4), 4, branches=3).plot(lambda path: path(0.5)[0])
    *runs, point = axes.get_lines()
    assert [run.get_linestyle() for run in runs] == ["-", "--", "-", "-"]
    assert [line.get_label() for line in axes.get_lines()[:2]] == ["Morse index 0", "Morse index 1"]
    assert len(axes.get_legend().get_texts()) == 3
    for bent in runs[2:]:  # they lead away from the branch point
        np.testing.assert_allclose(bent.get_xydata()[0], point.get_xydata()[0], rtol=0, atol=1e-12)


def test_a_branch_without_morse_indices_is_drawn_as_one():
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2, (0, 1), [0.0], [1.0], parameters=[0.0], force=lambda t, x, v, p: -p[0] * v
    )
    (line,) = cg.continuation(problem, [0.5], intervals=4).plot(lambda path: path(0.5)[0]).get_lines()
    assert line.get_label() == "no Morse index"


@pytest.mark.slow
def test_an_answer_shows_its_words_and_its_picture_in_a_notebook():
    import matplotlib.pyplot as plt

    path = planar().solve()
    shown = path._repr_html_()
    assert "Trajectory of 2 components" in shown
    assert "<svg" in shown
    assert plt.get_fignums() == []


def rods(x):
    """A fixed point, and one that slides."""
    return np.stack((np.zeros_like(x), x))


@pytest.mark.slow
def test_animation_moves_the_mechanism_along_the_path(tmp_path):
    from PIL import Image

    path = planar().solve()
    movie = path.animate(rods, seconds=0.2, frames=5)
    target = tmp_path / "movie.gif"
    movie.save(target, writer="pillow", dpi=40)
    with Image.open(target) as image:
        assert image.n_frames == 5
        assert image.info["duration"] == 40
    axes = movie._fig.axes[0]
    trail, bars = axes.get_lines()[-2:]  # of the last frame
    np.testing.assert_allclose(bars.get_xydata(), [[0, 0], [1, 0.5]], atol=1e-14)
    np.testing.assert_array_equal(trail.get_xydata(), path(np.linspace(0, 1, 5)).T)
    assert [text.get_text() for text in axes.texts] == ["t = 0", "t = 0.25", "t = 0.5", "t = 0.75", "t = 1"]


@pytest.mark.slow
def test_animation_takes_the_duration_of_the_path_and_the_axes_given(tmp_path):
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots()
    axes.set_xlabel("x in m")
    movie = planar(0.2).solve().animate(rods, axes, unit="ms", frames=4)
    movie.save(tmp_path / "movie.gif", writer="pillow", dpi=20)
    assert movie._fig is figure
    assert axes.texts[-1].get_text() == "t = 0.2 ms"
    assert axes.get_xlabel() == "x in m"
    assert len(axes.get_lines()[-2].get_xdata()) == 4
    assert movie._interval == 50  # milliseconds


def test_points_that_are_no_numbers_are_refused():
    with pytest.raises(TypeError, match="the places that points returns must be real numbers, got 'a'"):
        planar().solve().plot_poses(lambda x: "a")


def test_points_of_another_shape_are_refused():
    with pytest.raises(ValueError, match=r"points must return an array of shape \(n, 2, 100\), got \(2, 100\)"):
        planar().solve().animate(lambda x: x)


def test_a_picture_changes_nothing_for_the_users_own(monkeypatch):
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    subplots, before = plt.subplots, dict(mpl.rcParams)

    def first(*sizes, **options):
        mpl.interactive(True)  # as the backend of a notebook does when it makes the first figure
        return subplots(*sizes, **options)

    monkeypatch.setattr(plt, "subplots", first)
    monkeypatch.setitem(mpl.rcParams, "interactive", False)
    planar().solve().plot()
    assert dict(mpl.rcParams) == before | {"interactive": True}


def test_without_labels_components_are_numbered_and_the_title_is_the_path():
    problem = cg.BoundaryProblem(lambda t, x, v: ca.dot(v, v) / 2, (0.0, 1.0), [0.0, 1.0], [1.0, 3.0])
    axes = cg.solve(problem, cg.Galerkin(2), 4).plot()
    assert [line.get_label() for line in axes.lines[::2]] == ["x[0]", "x[1]"]
    assert axes.get_title() == "Degree 2 on 4 intervals: action 2.5, Morse index 0"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("t", "x")


def test_a_sweep_is_drawn_in_one_picture():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0])
    sweep = cg.sweep(problem, [{"end": [2.0]}, {"guess": [[np.nan] * 3]}, {"end": [3.0]}], cg.Galerkin(2), 2)
    axes = sweep.plot(labels="way in m", time="t in s")
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("t in s", "way in m")
    assert [line.get_ydata()[-1] for line in axes.lines] == [2.0, 3.0]
    assert [line.get_label() for line in axes.lines] == ["variation 0", "variation 2"]
    assert sweep.plot().get_ylabel() == "x[0]"
    with pytest.raises(ValueError, match="component must be a whole number from 0 to 0, got 1"):
        sweep.plot(1)
    assert not cg.sweep(problem, [], cg.Galerkin(2), 2).plot().lines


SHOWN = {
    "sweep": lambda problem: cg.sweep(problem, [{}], cg.Galerkin(2), 2),
    "branch": lambda problem: cg.continuation(problem, [2.0], intervals=4),
    "paths": lambda problem: cg.paths(problem, intervals=4, count=1),
    "comparison": lambda problem: cg.compare(problem, intervals=4),
}


@pytest.mark.parametrize("name", ["sweep", *slow("branch", "paths", "comparison")])
def test_a_notebook_shows_text_and_picture(name):
    problem = cg.BoundaryProblem(lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * x[0], (0, 1), [0.0], [1.0], parameters=[1.0])
    shown = SHOWN[name](problem)
    assert shown._repr_html_().startswith(f"<pre>{repr(shown).splitlines()[0]}")
    assert "<svg" in shown._repr_html_()
