"""The live viewer, without a browser: what its server holds for browsers to come."""

from __future__ import annotations

import re

import numpy as np
import pytest
from arms import template_arm
from viz.commands import server_commands

import pinposture as pp
import pinposture.viz
from pinposture.errors import InvalidValue, PostureError, UnknownName, ViewerError
from pinposture.viz import meshcat
from pinposture.viz.body import body_poses


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 3)


def some_run() -> pp.Run:
    arm = template_arm("RyRz", 3)
    rng = np.random.default_rng(0)
    target = pp.Target.from_configuration(arm, rng.uniform(-0.5, 0.5, arm.nv))
    return pp.track(arm, target, rng.uniform(-0.5, 0.5, arm.nv), "projection", max_steps=6)


def shown_poses(commands: list[dict]) -> np.ndarray:
    moved = {c["path"]: c["matrix"] for c in commands if c["type"] == "set_transform"}
    rows = [moved[f"/pinposture/arm/body_{u + 1:03d}"] for u in range(6)]
    return np.array(rows).reshape(-1, 4, 4).transpose(0, 2, 1)


def animations(commands: list[dict]) -> list[dict]:
    return [item for c in commands if c["type"] == "set_animation" for item in c["animations"]]


def test_an_arm_alone_is_shown_at_rest_and_then_wherever_it_is_told(arm, running):
    viewer = pp.view(arm, url=running.zmq_url)
    commands = server_commands(running.zmq_url)
    drawn = [c["path"] for c in commands if c["type"] == "set_object"]
    assert sum(path.endswith("/link") for path in drawn) == arm.nv
    assert sum(path.endswith("/point") for path in drawn) == 3
    assert not any("/target" in path for path in drawn)
    np.testing.assert_allclose(shown_poses(commands), body_poses(arm, arm.neutral()), atol=1e-12)
    q = arm.random(np.random.default_rng(1))
    viewer.show(q)
    np.testing.assert_allclose(shown_poses(server_commands(running.zmq_url)), body_poses(arm, q), atol=1e-12)
    viewer.close()


def test_a_run_is_played_after_all_that_it_moves_is_drawn(arm, running):
    run = some_run()
    with pp.view(arm, run, url=running.zmq_url) as viewer:
        commands = server_commands(running.zmq_url)
        kinds = [(c["type"], c["path"]) for c in commands]
        assert [kind for kind, _ in kinds].count("set_animation") == 1
        played = next(i for i, (kind, _) in enumerate(kinds) if kind == "set_animation")
        objects = {path: i for i, (kind, path) in enumerate(kinds) if kind == "set_object"}
        moved = {item["path"].removesuffix("/<object>") for item in animations(commands)}
        assert all(min(i for p, i in objects.items() if p.startswith(path)) < played for path in moved)
        assert "/pinposture/target/points" in objects
        assert viewer.url == running.web_url


def test_showing_a_configuration_stops_the_run_and_playing_starts_it_again(arm, running):
    run = some_run()
    viewer = pp.view(arm, run, url=running.zmq_url)
    viewer.show(run.q[-1])
    commands = server_commands(running.zmq_url)
    assert animations(commands) == []
    np.testing.assert_allclose(shown_poses(commands), body_poses(arm, run.q[-1]), atol=1e-12)
    viewer.play()
    assert len(animations(server_commands(running.zmq_url))) > arm.nv
    viewer.close()


def test_a_second_view_on_the_same_server_replaces_the_first(arm, running):
    pp.view(arm, some_run(), url=running.zmq_url).close()
    pp.view(pp.Arm.from_template("Rz", modules=2), url=running.zmq_url).close()
    drawn = [c["path"] for c in server_commands(running.zmq_url) if c["type"] == "set_object"]
    assert sum(path.endswith("/link") for path in drawn) == 2


def test_a_viewer_starts_a_server_on_this_machine_only_and_ends_it(arm, running, capfd):
    viewer = pp.view(arm)
    assert re.match(r"http://(127\.0\.0\.1|localhost):\d+/", viewer.url)
    viewer.close()
    viewer.close()
    with pytest.raises(ViewerError, match="closed"):
        viewer.show(arm.neutral())
    assert capfd.readouterr().out == ""


def test_what_does_not_fit_is_refused(arm, running):
    with pp.view(arm, url=running.zmq_url) as viewer:
        with pytest.raises(InvalidValue):
            viewer.show(np.zeros(arm.nq + 1))
        with pytest.raises(InvalidValue):
            viewer.show(np.full(arm.nq, np.nan))
        with pytest.raises(InvalidValue, match="run"):
            viewer.play()
    with pytest.raises(InvalidValue, match=r"run\.q"):
        pp.view(pp.Arm.from_template("RyRz", modules=4), some_run(), url=running.zmq_url)


def test_a_browser_is_opened_only_when_asked_for(arm, running, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda url, **options: opened.append(url))
    pp.view(arm, url=running.zmq_url).close()
    assert opened == []
    pp.view(arm, url=running.zmq_url, open_browser=True).close()
    assert opened == [running.web_url]


def test_unknown_viewers_are_refused_by_name(arm):
    with pytest.raises(UnknownName, match="meshcat") as caught:
        pp.view(arm, viewer="meshcta")
    assert caught.value.allowed == ("meshcat", "foxglove")


@pytest.mark.parametrize("address", ["nonsense", "tcp://127.0.0.1:1"])
def test_a_server_that_is_not_there_is_an_error_not_a_wait(arm, address, monkeypatch):
    monkeypatch.setattr(meshcat, "TIMEOUT", 200)
    with pytest.raises(ViewerError, match=re.escape(address)) as caught:
        pp.view(arm, url=address)
    assert isinstance(caught.value, PostureError)
