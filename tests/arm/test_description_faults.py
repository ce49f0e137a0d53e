"""A description with a fault is refused for the true reason, from whatever source it comes."""

from __future__ import annotations

import pytest
from arm.describing import links, pinocchio_loads, robot
from arm.faults import FAULTS

from pinposture.arm.description import read_description
from pinposture.errors import FileError, InvalidValue, URDFError


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_with_its_element_and_reason(fault):
    text, element, words, silent = FAULTS[fault]
    with pytest.raises(URDFError) as caught:
        read_description(text)
    assert (caught.value.source, caught.value.element) == ("URDF text", element)
    assert words in caught.value.reason
    if silent is not None:
        assert pinocchio_loads(text) is silent


def test_a_file_that_cannot_be_read_is_named_with_the_reason(tmp_path):
    (tmp_path / "empty.urdf").write_text("\ufeff \n")
    (tmp_path / "binary.urdf").write_bytes(b"<robot name='\xff\xfe'/>")
    (tmp_path / "utf16.urdf").write_bytes(robot(links("a")).encode("utf-16")[:-1])
    for name, reason in {
        "missing.urdf": "no such file",
        "": "directory",
        "empty.urdf": "empty",
        "binary.urdf": "UTF-8",
        "utf16.urdf": "is not utf-16 text",
        "x" * 5000: "cannot be read",
        "a\0b": "cannot be read",
    }.items():
        path = tmp_path / name
        with pytest.raises(FileError, match=reason) as caught:
            read_description(path)
        assert caught.value.path == path
    for source in ("", " ", "no-such-robot.urdf"):
        with pytest.raises(FileError):
            read_description(source)
    for source in (None, 3, b"<robot/>"):
        with pytest.raises(InvalidValue):
            read_description(source)


def test_a_fault_in_a_file_names_the_file(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(robot(""))
    with pytest.raises(URDFError) as caught:
        read_description(path)
    assert caught.value.source == str(path)
