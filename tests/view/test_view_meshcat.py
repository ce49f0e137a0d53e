"""The live viewer, without a browser: what its server holds for browsers to come."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest
from view.listening import held

import pinposture as pp
import pinposture.view
from pinposture.errors import InvalidValue, PostureError, UnknownName, ViewerError
from pinposture.view import server
from pinposture.view.body import body_poses

ARM = pp.Arm.from_template("RyRz", modules=3)


def some_run() -> pp.Trajectory:
    rng = np.random.default_rng(0)
    target = pp.Target.from_configuration(ARM, rng.uniform(-0.5, 0.5, ARM.nv))
    return pp.track(ARM, target, rng.uniform(-0.5, 0.5, ARM.nv), "projection", max_steps=6)


def shown_poses(commands: list[dict]) -> np.ndarray:
    moved = {c["path"]: c["matrix"] for c in commands if c["type"] == "set_transform"}
    rows = [moved[f"/pinposture/arm/body_{u + 1:03d}"] for u in range(ARM.nv)]
    return np.array(rows).reshape(-1, 4, 4).transpose(0, 2, 1)


def animations(commands: list[dict]) -> list[dict]:
    return [item for c in commands if c["type"] == "set_animation" for item in c["animations"]]


def test_an_arm_alone_is_shown_at_rest_and_then_wherever_it_is_told(running):
    viewer = pp.view(ARM, url=running.address)
    commands = held(running.address)
    drawn = [c["path"] for c in commands if c["type"] == "set_object"]
    assert sum(path.endswith("/link") for path in drawn) == ARM.nv
    assert sum(path.endswith("/point") for path in drawn) == 3
    assert not any("/target" in path for path in drawn)
    np.testing.assert_allclose(shown_poses(commands), body_poses(ARM, ARM.neutral()), atol=1e-12)
    q = ARM.random(np.random.default_rng(1))
    viewer.show(q)
    np.testing.assert_allclose(shown_poses(held(running.address)), body_poses(ARM, q), atol=1e-12)
    viewer.close()


def test_a_run_is_played_after_all_that_it_moves_is_drawn(running):
    run = some_run()
    with pp.view(ARM, run, url=running.address) as viewer:
        commands = held(running.address)
        kinds = [(c["type"], c["path"]) for c in commands]
        assert [kind for kind, _ in kinds].count("set_animation") == 1
        played = next(i for i, (kind, _) in enumerate(kinds) if kind == "set_animation")
        objects = {path: i for i, (kind, path) in enumerate(kinds) if kind == "set_object"}
        moved = {item["path"].removesuffix("/<object>") for item in animations(commands)}
        assert all(min(i for p, i in objects.items() if p.startswith(path)) < played for path in moved)
        assert "/pinposture/target/points" in objects
        assert viewer.url == running.url


def test_showing_a_configuration_stops_the_run_and_playing_starts_it_again(running):
    run = some_run()
    viewer = pp.view(ARM, run, url=running.address)
    viewer.show(run.q[-1])
    commands = held(running.address)
    assert animations(commands) == []
    np.testing.assert_allclose(shown_poses(commands), body_poses(ARM, run.q[-1]), atol=1e-12)
    viewer.play()
    assert len(animations(held(running.address))) > ARM.nv
    viewer.close()


def test_a_second_view_on_the_same_server_replaces_the_first(running):
    pp.view(ARM, some_run(), url=running.address).close()
    pp.view(pp.Arm.from_template("Rz", modules=2), url=running.address).close()
    drawn = [c["path"] for c in held(running.address) if c["type"] == "set_object"]
    assert sum(path.endswith("/link") for path in drawn) == 2


def test_a_viewer_starts_a_server_on_this_machine_only_and_ends_it(running, capfd):
    viewer = pp.view(ARM)
    assert re.match(r"http://(127\.0\.0\.1|localhost):\d+/", viewer.url)
    viewer.close()
    viewer.close()
    with pytest.raises(ViewerError, match="closed"):
        viewer.show(ARM.neutral())
    assert capfd.readouterr().out == ""


def test_what_does_not_fit_is_refused(running):
    with pp.view(ARM, url=running.address) as viewer:
        with pytest.raises(InvalidValue):
            viewer.show(np.zeros(ARM.nq + 1))
        with pytest.raises(InvalidValue):
            viewer.show(np.full(ARM.nq, np.nan))
        with pytest.raises(InvalidValue, match="run"):
            viewer.play()
    with pytest.raises(InvalidValue, match=r"run\.q"):
        pp.view(pp.Arm.from_template("RyRz", modules=4), some_run(), url=running.address)


def test_a_browser_is_opened_only_when_asked_for(running, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda url, **options: opened.append(url))
    pp.view(ARM, url=running.address).close()
    assert opened == []
    pp.view(ARM, url=running.address, open_browser=True).close()
    assert opened == [running.url]


def test_unknown_viewers_are_refused_by_name():
    with pytest.raises(UnknownName, match="meshcat") as caught:
        pp.view(ARM, viewer="meshcta")
    assert caught.value.allowed == ("meshcat",)


@pytest.mark.parametrize("address", ["nonsense", "tcp://127.0.0.1:1"])
def test_a_server_that_is_not_there_is_an_error_not_a_wait(address, monkeypatch):
    monkeypatch.setattr(server, "PATIENCE", 200)
    with pytest.raises(ViewerError, match=re.escape(address)) as caught:
        pp.view(ARM, url=address)
    assert isinstance(caught.value, PostureError)


def test_view_can_be_called_once_its_package_is_imported():
    assert "pinposture.view" in sys.modules
    with pytest.raises(UnknownName):
        pinposture.view(ARM, viewer="none")
