"""A build of the ROS package has the files that ROS needs; colcon itself is not run."""

import ast
import subprocess
import sys
import zipfile
from configparser import ConfigParser
from email.parser import HeaderParser
from pathlib import Path

import pytest
from lxml import etree

from oracle_graph_recorder import interval_graphs

ROOT = Path(__file__).parents[2] / "ros2" / "oracle_graph_recorder"
NAME = "oracle_graph_recorder"
OF_ROS = {"rclpy", "launch", "launch_ros", "rosidl_runtime_py"}


def syntax(path):
    return ast.parse((ROOT / path).read_text(encoding="utf-8"))


def calls(tree, name):
    """Return the keyword arguments of each call of a function."""
    return [
        {word.arg: word.value for word in node.keywords}
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and name in (getattr(node.func, "id", None), getattr(node.func, "attr", None))
    ]


@pytest.fixture(scope="module")
def manifest():
    parser = etree.XMLParser(resolve_entities=False, no_network=True)
    return etree.parse(str(ROOT / "package.xml"), parser).getroot()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The package as setuptools builds it; colcon uses the same setup.py."""
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "setup.py", "-q", "egg_info", "--egg-base", folder,
         "build", "--build-base", folder / "build", "bdist_wheel", "--dist-dir", folder],
        cwd=ROOT, check=True, capture_output=True,
    )  # fmt: skip
    (built,) = folder.glob("*.whl")
    with zipfile.ZipFile(built) as archive:
        return {name: archive.read(name).decode() for name in archive.namelist()}


def test_a_build_installs_what_ros_looks_for(wheel):
    shared = {name.partition(".data/data/")[2] for name in wheel} - {""}
    assert shared == {
        f"share/ament_index/resource_index/packages/{NAME}",
        f"share/{NAME}/package.xml",
        f"share/{NAME}/launch/record_graphs.launch.py",
    }
    modules = ("__init__", "recorder_node", "interval_graphs")
    assert {f"{NAME}/{module}.py" for module in modules} <= wheel.keys()


def test_the_build_has_the_version_and_licence_of_the_manifest(wheel, manifest):
    (metadata,) = (text for name, text in wheel.items() if name.endswith(".dist-info/METADATA"))
    built = HeaderParser().parsestr(metadata)
    for tag in ("version", "license"):
        assert built[tag] == manifest.findtext(tag)
    assert built["summary"] == manifest.findtext("description")


def test_programs_are_in_the_folder_that_ros_run_searches(wheel):
    settings = ConfigParser()
    settings.read(ROOT / "setup.cfg")
    assert settings["install"]["install_scripts"] == f"$base/lib/{NAME}"
    assert settings["develop"]["script_dir"] == f"$base/lib/{NAME}"
    (entries,) = (text for name, text in wheel.items() if name.endswith("entry_points.txt"))
    programs = ConfigParser()
    programs.read_string(entries)
    module, _, function = programs["console_scripts"]["recorder"].partition(":")
    tree = syntax(f"{module.replace('.', '/')}.py")
    assert function in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_imported_ros_packages_are_declared(manifest):
    declared = {each.text for each in manifest.iterfind("exec_depend")}
    imported = set()
    for path in ROOT.rglob("*.py"):
        for node in ast.walk(syntax(path.relative_to(ROOT))):
            names = [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
            names += [each.name for each in node.names] if isinstance(node, ast.Import) else []
            imported |= {name.partition(".")[0] for name in names}
    assert imported & OF_ROS == declared
    known = {NAME, "networkx", "oracle_pipeline", "setuptools", *sys.stdlib_module_names}
    assert imported - OF_ROS <= known


def test_the_node_imports_what_its_module_has():
    names = {
        alias.name
        for node in ast.walk(syntax(f"{NAME}/recorder_node.py"))
        if isinstance(node, ast.ImportFrom) and node.module == interval_graphs.__name__
        for alias in node.names
    }
    assert names
    assert names <= vars(interval_graphs).keys()


def test_the_launch_file_starts_the_program_with_parameters_that_it_declares():
    tree = syntax("launch/record_graphs.launch.py")
    (node,) = calls(tree, "Node")
    assert ast.literal_eval(node["package"]) == NAME
    assert ast.literal_eval(node["executable"]) == "recorder"
    (parameters,) = node["parameters"].elts
    given = {ast.literal_eval(key) for key in parameters.keys}
    recorder = ast.walk(syntax(f"{NAME}/recorder_node.py"))
    declared = {
        ast.literal_eval(each.args[0])
        for each in recorder
        if isinstance(each, ast.Call) and getattr(each.func, "attr", "") == "declare_parameter"
    }
    assert given <= declared | {"use_sim_time"}  # which every node has
