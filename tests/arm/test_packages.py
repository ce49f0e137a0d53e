"""Mesh files and packages are found as ROS and Gazebo find them."""

from __future__ import annotations

from pathlib import Path

import pytest

from pinposture.collision.files import find_mesh
from pinposture.errors import FileError


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package, called snake in its manifest only, with a mesh whose name has a blank and an umlaut."""
    folder = tmp_path / "ws" / "src" / "snake-main"
    (folder / "meshes").mkdir(parents=True)
    manifest = '<?xml version="1.0" encoding="latin-1"?><!-- ü --><package><name>snake</name></package>'
    (folder / "package.xml").write_bytes(manifest.encode("latin-1"))
    (folder / "meshes" / "a bü.stl").touch()
    return folder


@pytest.mark.parametrize("rest", ["meshes/a%20b%C3%BC.stl", "meshes/a bü.stl", "/meshes/a%20bü.stl"])
@pytest.mark.parametrize("scheme", ["package", "model", "PACKAGE"])
def test_addresses_are_decoded_in_every_scheme(package: Path, scheme: str, rest: str) -> None:
    mesh = package / "meshes" / "a bü.stl"
    for folder in (package.parent.parent, package.parent, package, package / "meshes"):
        assert find_mesh(f"{scheme}://snake/{rest}", [str(folder)]).resolve() == mesh
    if scheme == "package":
        written = rest.removeprefix("/")
        assert find_mesh(f"file://{package.as_posix()}/{written}") == mesh
        assert find_mesh(f"file://localhost{package.as_posix()}/{written}") == mesh


def test_a_name_that_is_no_address_is_taken_as_it_is(package: Path) -> None:
    for name in ("a%20b.stl", "50%.stl", "a#b.stl"):
        (package / "meshes" / name).touch()
        for address in (
            f"package://snake/meshes/{name}",
            f"meshes/{name}",
            f"file://{package}/meshes/{name}",
        ):
            assert find_mesh(address, [str(package)]) == package / "meshes" / name


def test_the_environment_is_searched_after_the_folders_that_are_given(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    address = "package://snake/meshes/a%20b%C3%BC.stl"
    for variable, folder in (("ROS_PACKAGE_PATH", package.parent), ("ROS_PACKAGE_PATH", package)):
        monkeypatch.setenv(variable, f"{tmp_path / 'none'}:{folder}")
        assert find_mesh(address).parent == package / "meshes"
    monkeypatch.delenv("ROS_PACKAGE_PATH")
    installed = tmp_path / "install" / "share" / "snake"
    installed.parent.mkdir(parents=True)
    package.rename(installed)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "install"))
    assert find_mesh(address).parent == installed / "meshes"
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", str(installed.parent))
    assert find_mesh(address.replace("package:", "model:")).parent == installed / "meshes"
    with pytest.raises(FileError, match="not found"):
        find_mesh(address)


@pytest.mark.parametrize("scheme", ["https", "http", "ftp", "fuel"])
def test_other_schemes_are_named(scheme: str) -> None:
    with pytest.raises(FileError, match=rf"scheme is '{scheme}'; allowed: package://, model://"):
        find_mesh(f"{scheme}://example.org/a.stl", ["."])


def test_a_name_never_leads_out_of_a_package(tmp_path: Path) -> None:
    (tmp_path / "inner").mkdir()
    (tmp_path / "a.stl").touch()
    for name in ("..", ".", "", "%2e%2e", "..%2f"):
        with pytest.raises(FileError, match="not found"):
            find_mesh(f"package://{name}/a.stl", [str(tmp_path / "inner")])
