"""The files of the ROS package agree with each other, as far as testable without ROS."""

import ast
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

import oracle_pipeline.graphs.rclpy_graphs as shared

PACKAGE = Path(__file__).parent.parent.parent / "ros2" / "oracle_graph_recorder"
NAME = PACKAGE.name


@pytest.fixture
def setup(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The arguments that setup.py passes to setuptools."""
    arguments: dict[str, Any] = {}
    tree = ast.parse((PACKAGE / "setup.py").read_text())
    (call,) = (
        n for n in ast.walk(tree) if isinstance(n, ast.Call) and ast.unparse(n.func) == "setup"
    )
    for keyword in call.keywords:
        arguments[str(keyword.arg)] = eval(ast.unparse(keyword.value), {"NAME": NAME})  # noqa: S307
    return arguments


def test_package_xml_and_setup_agree(setup: dict[str, Any]) -> None:
    root = ET.parse(PACKAGE / "package.xml").getroot()  # noqa: S314 -- our own file
    assert {tag: root.findtext(tag) for tag in ("name", "version", "license", "description")} == {
        tag: setup[tag] for tag in ("name", "version", "license", "description")
    }
    assert root.findtext("export/build_type") == "ament_python"


def test_every_installed_file_exists(setup: dict[str, Any]) -> None:
    for _, files in setup["data_files"]:
        for file in files:
            assert (PACKAGE / file).is_file(), file


def test_the_launch_file_starts_what_setup_installs(setup: dict[str, Any]) -> None:
    (script,) = setup["entry_points"]["console_scripts"]
    executable, _, target = script.partition(" = ")
    module, _, function = target.partition(":")
    source = ast.parse((PACKAGE / f"{module.replace('.', '/')}.py").read_text())
    assert function in {n.name for n in source.body if isinstance(n, ast.FunctionDef)}
    launch = (PACKAGE / "launch" / "record_graphs.launch.py").read_text()
    assert f'package="{NAME}"' in launch
    assert f'executable="{executable}"' in launch


def test_the_node_imports_what_the_shared_module_has() -> None:
    tree = ast.parse((PACKAGE / NAME / "recorder_node.py").read_text())
    (names,) = (
        [alias.name for alias in node.names]
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module == shared.__name__
    )
    assert all(hasattr(shared, name) for name in names)
