"""What `pinposture compile` runs reaches every kernel, on every machine."""

from __future__ import annotations

import warnings

import pytest

from pinposture import kernels
from pinposture.cli.compile import jobs


def callees(kernel: object) -> set[str]:
    """Names of the kernels that a kernel calls, and that these call."""
    waiting, found = [kernel.py_func], set()
    while waiting:
        function = waiting.pop()
        for name in function.__code__.co_names:
            called = getattr(function.__globals__.get(name), "py_func", None)
            if called is not None and name not in found:
                found.add(name)
                waiting.append(called)
    return found


def test_every_kernel_is_used_by_some_job(monkeypatch: pytest.MonkeyPatch) -> None:
    used = set()

    def recorded(name: str):
        kernel = getattr(kernels, name)
        inside = callees(kernel)

        def call(*given):
            used.update({name}, inside)
            return kernel(*given)

        return call

    for name in kernels.NAMES:
        monkeypatch.setattr(kernels, name, recorded(name), raising=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for job in jobs():
            job()
    assert set(kernels.NAMES) - used == set()
