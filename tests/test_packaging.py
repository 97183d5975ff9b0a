"""What is installed is what is in the tree: the wheel's contents, the licence, the entry points."""

from __future__ import annotations

import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import entry_points
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("cyclekit", "adapters/cyclekit_adapters", "sim_fixtures/cyclekit_sim")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Names in the wheel."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (file,) = folder.glob("*.whl")
    with zipfile.ZipFile(file) as archive:
        return archive.namelist()


def in_tree() -> set[str]:
    found = set()
    for package in PACKAGES:
        folder = ROOT / package
        for file in folder.rglob("*"):
            if file.is_file() and "__pycache__" not in file.parts and not file.name.startswith("."):
                found.add(file.relative_to(folder.parent).as_posix())
    return found


def test_the_wheel_holds_every_file_of_the_three_packages_and_nothing_else(wheel: list[str]) -> None:
    packed = {name for name in wheel if ".dist-info/" not in name}
    assert packed == in_tree()


def test_the_wheel_holds_types_templates_and_licence(wheel: list[str]) -> None:
    assert {f"{Path(package).name}/py.typed" for package in PACKAGES} <= set(wheel)
    assert any(name.endswith("licenses/LICENSE") for name in wheel)


def test_the_licence_is_the_whole_apache_licence() -> None:
    text = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert "Version 2.0, January 2004" in text
    assert "END OF TERMS AND CONDITIONS" in text
    assert PROJECT["project"]["license"] == "Apache-2.0"


def test_every_adapter_of_the_project_file_is_installed_and_loads() -> None:
    stated = PROJECT["project"]["entry-points"]["cyclekit.adapters"]
    installed = {point.name: point for point in entry_points(group="cyclekit.adapters")}
    missing = set(stated) - set(installed)
    assert not missing, f"{missing}: a new entry point needs an installation: pip install -e ."
    for name, value in stated.items():
        assert installed[name].value == value
        adapter = installed[name].load()
        assert callable(adapter.recognises)
        assert callable(adapter.read)


def test_the_command_is_installed_and_is_the_one_of_the_project_file() -> None:
    (command,) = entry_points(group="console_scripts", name="cyclekit")
    assert command.value == PROJECT["project"]["scripts"]["cyclekit"]
    assert callable(command.load())


def test_torch_is_an_extra_and_never_a_requirement() -> None:
    assert not any(line.startswith("torch") for line in PROJECT["project"]["dependencies"])
    assert any(line.startswith("torch") for line in PROJECT["project"]["optional-dependencies"]["train"])


def test_every_module_of_a_package_can_be_found_by_the_installed_interpreter() -> None:
    code = "import cyclekit, cyclekit_adapters, cyclekit_sim; print(cyclekit.__version__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT.anchor)
    assert done.stdout.strip() == PROJECT["project"]["version"]


def test_the_container_installs_extras_that_exist_and_needs_no_registry_by_name() -> None:
    lines = (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines()
    given = dict(line.removeprefix("ARG ").split("=", 1) for line in lines if line.startswith("ARG "))
    assert set(given["EXTRAS"].split(",")) <= set(PROJECT["project"]["optional-dependencies"])
    assert "/" not in given["PYTHON"]
    asked = PROJECT["project"]["requires-python"].removeprefix(">=")
    assert given["PYTHON"].startswith(f"python:{asked}")
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").split()
    assert {".git", ".venv", "out"} <= set(ignored)
    copied = [line.split()[1] for line in lines if line.startswith("COPY ")]
    assert [name for name in copied if not (ROOT / name).exists()] == []


def test_the_classifiers_are_known_and_name_the_oldest_python() -> None:
    from trove_classifiers import classifiers

    stated = PROJECT["project"]["classifiers"]
    assert set(stated) <= set(classifiers)
    oldest = PROJECT["project"]["requires-python"].removeprefix(">=")
    assert f"Programming Language :: Python :: {oldest}" in stated
