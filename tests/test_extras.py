"""What an error or a page says about installing works as it stands: there is no package on an index yet."""

import importlib.metadata
import re
import shlex
import subprocess
import sys
import tomllib
from importlib.util import find_spec

import pytest

from baggie.cameras import open_camera
from baggie.cameras.camera import CameraSettings
from baggie.errors import CameraError, install_extra, pip_install
from helpers.docs_pages import PAGES, ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = {name: wanted for name, wanted in PROJECT["optional-dependencies"].items() if name != "dev"}
IMPORTED = {"deploy": "onnxruntime", "export": "onnx", "realsense": "pyrealsense2", "franka": "franky"}
"""What is here wherever tests are, on a computer for which there are wheels."""


def words(command: str) -> set[str]:
    return {",".join(sorted(re.split(",|(?=[<>])", word))) for word in shlex.split(command)}


@pytest.mark.parametrize("extra", EXTRAS)
def test_the_command_names_what_the_extra_asks_for_and_this_python(extra: str) -> None:
    assert words(install_extra(extra)) == words(
        shlex.join([sys.executable, "-m", "pip", "install", *EXTRAS[extra]])
    )


def test_the_command_does_what_it_says() -> None:
    """Here everything is there already, so nothing is fetched and nothing changes."""
    here = [extra for extra, module in IMPORTED.items() if find_spec(module)]
    if not here:
        pytest.skip("none of the extras is here: python -m pip install --editable '.[dev]'")
    all_at_once = dict.fromkeys(word for extra in here for word in shlex.split(install_extra(extra)))
    command = [*all_at_once, "--dry-run", "--no-index"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Would install" not in done.stdout


def test_source_that_is_not_installed_is_installed_from_where_it_lies(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def nowhere(name: str) -> list[str]:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr("baggie.errors.requires", nowhere)
    assert install_extra("franka") == pip_install(f"{ROOT}[franka]")


@pytest.mark.parametrize("kind", ["realsense", "orbbec", "k4a"])
def test_a_camera_without_its_package_says_how_to_install_it(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for package in ("pyrealsense2", "pyorbbecsdk", "pyk4a"):
        monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(CameraError) as refused:
        open_camera(CameraSettings(kind=kind))
    assert str(refused.value).endswith(install_extra(kind))


def test_pages_install_what_can_be_installed() -> None:
    """By the packages' own names, as wide as the extras; nothing is asked of an index that is not on it."""
    wanted = {",".join(sorted(re.split(",|(?=[<>])", word))) for words in EXTRAS.values() for word in words}
    for page in PAGES:
        text = page.read_text()
        assert not re.search(r"pip install [^`\n]*['\" ]baggie\b", text), page.name
        for name, bounds in re.findall(r"['\"]([\w-]+)([<>]=?[\d.,<>=]+)['\"]", text):
            known = [package for package in wanted if package.startswith(name)]
            assert not known or ",".join(sorted(re.split(",|(?=[<>])", name + bounds))) in known, (
                f"{page.name}: {name}"
            )
