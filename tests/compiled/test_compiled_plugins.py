"""A compiled plugin offers features like any other, and its failures affect only its own."""

import shutil
import subprocess
from pathlib import Path

import pytest

from oracle_pipeline.features import build_manager, extract
from oracle_pipeline.features.adapters.compiled import PluginProcess, load_compiled
from oracle_pipeline.features.engine.plugin import PluginError
from oracle_pipeline.opened_run import open_run

REPOSITORY = Path(__file__).parents[2]
INCLUDE = REPOSITORY / "oracle_pipeline" / "features" / "adapters"
EXAMPLE = REPOSITORY / "examples" / "compiled_plugin"

ODD = """
#include <stdlib.h>
#include <unistd.h>
#include "oracle_plugin.h"

static int32_t compute(const struct OracleWindow* window, struct ArrowSchema* schema,
                       struct ArrowArray* array, char* error, size_t size) {
  %s
}

static const struct OraclePluginV1 plugin = {
  "{\\"name\\": \\"odd\\", \\"family\\": \\"odd\\", \\"features\\": [{\\"name\\": \\"value\\", "
  "\\"unit\\": \\"1\\", \\"floor\\": 1, \\"description\\": \\"a number\\"}], "
  "\\"topics\\": {\\"scans\\": {\\"role\\": \\"scan\\", \\"fields\\": [\\"ranges\\"]}}}", compute};

const struct OraclePluginV1* oracle_plugin_%s(void) { return &plugin; }
"""


def built_in_cpp(build):
    ran(["cmake", "-S", str(EXAMPLE), "-B", str(build), "-DCMAKE_BUILD_TYPE=Release"])
    ran(["cmake", "--build", str(build)])
    return build / "clearance.so"


def built_in_rust(build):
    library = build / "clearance_rust.so"
    source = str(EXAMPLE / "clearance.rs")
    ran(["rustc", "--edition", "2021", "-O", "--crate-type", "cdylib", source, "-o", str(library)])
    return library


# By family of the features. Rust is for those who have it; C++ is required, as cmake is.
EXAMPLES = {"compiled": built_in_cpp} | ({"rust": built_in_rust} if shutil.which("rustc") else {})


@pytest.fixture(params=EXAMPLES)
def example(request, tmp_path):
    """An example of the repository, built as its guide says: the family and the library."""
    return request.param, EXAMPLES[request.param](tmp_path)


def ran(command):
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture
def odd(tmp_path):
    """Return a function that makes a plugin of a C statement."""

    def made(statement: str, version: str = "v1") -> Path:
        source = tmp_path / "odd.c"
        source.write_text(ODD % (statement, version), "utf-8")
        library = tmp_path / "odd.so"
        ran(["cc", "-shared", "-fPIC", f"-I{INCLUDE}", str(source), "-o", str(library)])
        return library

    return made


def test_an_example_computes_what_its_python_twin_does(recorded_run, example, tmp_path):
    family, library = example
    plugins = tmp_path / "plugins"
    plugins.mkdir()
    shutil.copy(library, plugins)
    (plugins / "twin.py").write_text(
        "import numpy as np\n"
        "from oracle_pipeline.features import Feature, FeaturePlugin, Request, hookimpl\n"
        "def keep(scan):\n"
        "    ranges = scan.ranges[scan.ranges >= scan.range_min]\n"
        "    return ranges.min(initial=np.inf)\n"
        "def compute(window):\n"
        "    scans = [s.values for s in window.topics['scans'].values()]\n"
        "    return {'nearest': min(s.min() for s in scans), 'scans': sum(map(len, scans))}\n"
        "@hookimpl\n"
        "def register_features():\n"
        "    features = (Feature('nearest', 'm', 0.02, 'it', 'domain'),\n"
        "                Feature('scans', '1', 1, 'them', 'domain'))\n"
        "    return [FeaturePlugin('twin', 'twin', features, compute,\n"
        "                          {'scans': Request(keep, role='scan')})]\n",
        "utf-8",
    )
    manager = build_manager(plugins)
    assert not manager.broken
    with open_run(recorded_run("lidar_passthrough").path) as run:
        tables = extract(run, manager)
    for table in tables:
        for name in ("nearest", "scans"):
            assert table[f"{family}.{name}"].notna().all()
            assert table[f"{family}.{name}"].tolist() == table[f"twin.{name}"].tolist()


def test_a_crash_loses_only_the_features_of_the_plugin(recorded_run, odd):
    manager = build_manager(odd("abort();").parent)
    with open_run(recorded_run("lidar_passthrough").path) as run:
        row = extract(run, manager).run.iloc[0]
    assert "the process of the compiled plugin ended: SIGABRT" in row["missing"]
    assert row["contextual.clearance"] > 0.0


WINDOW = {"folder": "", "start_s": 0.0, "end_s": 1.0, "tables": []}


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("*(volatile int*)0 = 1; return 0;", "ended: SIG(SEGV|ILL|TRAP)"),
        ("exit(3);", "ended: exit code 3"),
        ("for (;;) sleep(1);", "it took longer than 5 s"),
        ("error[0] = 'n'; error[1] = 'o'; error[2] = 0; return 7;", "ValueError: no$"),
        ("return 7;", "it returned 7"),
    ],
)
def test_the_error_of_a_plugin_is_described(odd, statement, said):
    process = PluginProcess(odd(statement), seconds=5.0)
    with pytest.raises(PluginError, match=said):
        process.ask(WINDOW)


def test_a_plugin_for_another_version_is_refused_with_an_error(odd):
    with pytest.raises(PluginError, match="no function oracle_plugin_v1; it is no plugin, or one"):
        load_compiled(odd("return 0;", "v2"))
