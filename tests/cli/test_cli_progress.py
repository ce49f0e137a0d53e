from __future__ import annotations

from pinposture.cli.output import count_progress


def test_a_terminal_sees_how_much_is_done(monkeypatch, capsys):
    with count_progress("run") as tell:
        tell(1, 4)
    assert capsys.readouterr().err == ""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with count_progress("run") as tell:
        tell(3, 4)
    assert "run 3 of 4" in capsys.readouterr().err
