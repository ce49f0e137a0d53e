from __future__ import annotations

import json
import signal

import pytest

ADDRESS = "http://127.0.0.1:7000/static/"


class Viewer:
    """Stands in for meshcat, and writes down what is asked of it."""

    url = ADDRESS

    def __init__(self, asked):
        self.asked = asked

    def play(self):
        self.asked.append("play")

    def close(self):
        self.asked.append("close")


@pytest.fixture
def asked(monkeypatch):
    """What was asked of the viewer; Ctrl-C comes as soon as the command waits for it."""
    asked = []

    def view(arm, run=None, target=None, viewer="meshcat", open_browser=False, ellipsoids=()):
        if ellipsoids:
            asked.append(("ellipsoids", *ellipsoids))
        asked.append(("view", arm.nv, run.steps, target is None, viewer, open_browser))
        return Viewer(asked)

    def wait():
        asked.append("wait")
        raise KeyboardInterrupt

    monkeypatch.setattr("pinposture.viz.view", view)
    monkeypatch.setattr("pinposture.cli.view.wait", wait)
    return asked


@pytest.mark.parametrize("name", [".", "run.npz"])
def test_a_run_plays_until_ctrl_c_which_is_no_failure(command, run_directory, asked, name):
    result = command("view", run_directory / name)
    assert (result.code, result.out) == (0, f"{ADDRESS}\n")
    assert asked == [("view", 12, 20, True, "meshcat", True), "play", "wait", "close"]


def test_no_browser_is_opened_if_none_is_wanted(command, run_directory, asked):
    command("view", run_directory, "--no-browser")
    assert asked[0][-1] is False


def test_the_viewer_can_be_chosen(command, run_directory, asked):
    command("view", run_directory, "--viewer", "foxglove")
    assert asked[0] == ("view", 12, 20, True, "foxglove", True)


def test_ctrl_c_that_something_swallows_while_the_viewer_starts_ends_it_all_the_same(
    command, run_directory, asked, monkeypatch
):
    def view(*_, **__):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            asked.append("swallowed")
        return Viewer(asked)

    monkeypatch.setattr("pinposture.viz.view", view)
    before = signal.getsignal(signal.SIGINT)
    assert command("view", run_directory, "--no-browser").code == 0
    assert asked == ["close"]
    assert signal.getsignal(signal.SIGINT) is before


def test_a_second_ctrl_c_while_the_viewer_starts_ends_it_at_once(command, run_directory, asked, monkeypatch):
    def view(*_, **__):
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        asked.append("started")

    monkeypatch.setattr("pinposture.viz.view", view)
    assert command("view", run_directory, "--no-browser").code == 0
    assert asked == []


def test_the_viewer_is_closed_after_an_error_too(command, run_directory, asked, monkeypatch):
    def broken(_):
        raise ZeroDivisionError

    monkeypatch.setattr(Viewer, "play", broken)
    with pytest.raises(ZeroDivisionError):
        command("view", run_directory)
    assert asked[-1] == "close"


@pytest.mark.long
def test_a_file_is_written_instead_of_showing(command, run_directory, asked, tmp_path):
    html = tmp_path / "a.html"
    png = tmp_path / "sub" / "plot.PNG"
    assert command("view", run_directory, "-o", html) == (0, "", f"wrote {html}\n")
    assert command("view", run_directory, "--output", png) == (0, "", f"wrote {png}\n")
    assert "<html" in html.read_text(encoding="utf-8").lower()
    assert png.read_bytes().startswith(b"\x89PNG\r\n")
    assert asked == []


def test_track_shows_the_run_at_last_and_keeps_stdout_for_the_summary(command, arm_file, asked):
    options = ("--steps", 2, "--view", "--json")
    result = command("track", arm_file, "--curve", "helix", *options)
    assert json.loads(result.out)["steps"] == 2
    assert ADDRESS in result.err
    assert [entry[0] if isinstance(entry, tuple) else entry for entry in asked] == [
        "view",
        "play",
        "wait",
        "close",
    ]
    assert result.code == 1


def test_ellipsoids_are_shown_at_points_given_by_number_at_the_scale_that_is_told(
    command, run_directory, asked
):
    result = command("view", run_directory, "--ellipsoids", "2, 6")
    assert (result.code, result.out) == (0, f"{ADDRESS}\n")
    assert asked[0] == ("ellipsoids", 1, 5)
    assert "1 m/rad drawn as " in result.err
    command("view", run_directory, "--ellipsoids", "all")
    assert ("ellipsoids", 0, 1, 2, 3, 4, 5) in asked


def test_ellipsoids_are_in_the_animation_that_is_written(command, run_directory, asked, tmp_path):
    html = tmp_path / "a.html"
    result = command("view", run_directory, "-o", html, "--ellipsoids", "6")
    assert result.err == f"wrote {html}\n"
    assert "ellipsoids, 1 m/rad drawn as" in html.read_text(encoding="utf-8")
    command("view", run_directory, "-o", html)
    assert "ellipsoids, 1 m/rad drawn as" not in html.read_text(encoding="utf-8")


@pytest.mark.parametrize("points", ["0", "7", "1,7", "1,,2", "", "one", "1.0", "2,2", "-1", "all,1"])
def test_numbers_of_no_control_point_are_refused(command, run_directory, asked, points):
    result = command("view", run_directory, "--ellipsoids", points)
    assert result.code == 2
    assert result.err.startswith("error: --ellipsoids is ")
    assert "from 1 to 6" in result.err
    assert asked == []


def test_ellipsoids_for_a_plot_that_shows_none_are_refused(command, run_directory, tmp_path):
    result = command("view", run_directory, "-o", tmp_path / "a.png", "--ellipsoids", "all")
    assert (result.code, list(tmp_path.iterdir())) == (2, [])
    assert "--ellipsoids is 'all'; allowed: nothing with a .png file" in result.err
