import shutil

import pytest

from oracle_pipeline.bags.errors import BagError, ManifestError, RunDirectoryError
from oracle_pipeline.opened_run import open_run
from tests.manifests import rewrite


def test_a_run_directory_is_opened_with_all_its_parts(make_run):
    with open_run(make_run().path) as run:
        assert run.manifest.mode == "fake_object"
        assert [interval.start_s for interval in run.intervals] == [0.0, 10.0, 20.0]
        assert run.duration_s == pytest.approx(27.0)
        assert "/scan" in run.bag.topics
        assert "/_oracle/ground_truth" not in run.bag.topics


def test_a_run_directory_may_be_anywhere(make_run, tmp_path):
    shutil.copytree(make_run().path, tmp_path / "copy")
    with open_run(tmp_path / "copy") as run:
        assert run.manifest.run == 3


def test_a_foreign_bag_has_neither_manifest_nor_graphs(foreign_bag):
    with open_run(foreign_bag) as run:
        assert run.manifest is None
        assert run.intervals == ()
        assert run.bag.message_count > 0


def test_a_path_that_is_neither_run_nor_bag_is_an_error(tmp_path):
    with pytest.raises(BagError, match="not a bag"):
        open_run(tmp_path)
    with pytest.raises(BagError, match="no bag"):
        open_run(tmp_path / "absent")


@pytest.mark.parametrize(
    ("part", "error", "text"),
    [
        ("manifest.json", RunDirectoryError, "has no manifest.json"),
        ("graphs", RunDirectoryError, "damaged: graphs/000000.gexf, graphs/000010.gexf"),
        ("graphs/000010.gexf", RunDirectoryError, r"damaged: graphs/000010\.gexf is"),
        ("bag", BagError, "no bag"),
        ("bag/metadata.yaml", RunDirectoryError, r"damaged: bag/metadata\.yaml is"),
        ("bag/bag_0.mcap", RunDirectoryError, r"damaged: bag/bag_0\.mcap is"),
    ],
)
def test_a_run_directory_without_a_part_is_an_error(part, error, text, make_run):
    directory = make_run()
    path = directory.path / part
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink()
    with pytest.raises(error, match=text):
        open_run(directory.path)


@pytest.mark.parametrize("part", ["manifest.json", "graphs/000010.gexf", "bag/bag_0.mcap"])
def test_a_run_directory_with_a_broken_part_is_an_error(part, make_run):
    directory = make_run()
    (directory.path / part).write_text("{")
    with pytest.raises((ManifestError, RunDirectoryError), match=part.split("/")[-1]):
        open_run(directory.path)


def test_a_trimmed_bag_is_not_taken_for_the_complete_one(make_run):
    directory = make_run()
    more = {"/map": {"type": "nav_msgs/msg/OccupancyGrid", "messages": 1}}
    rewrite(directory, lambda document: document["topics"].update(more))
    with pytest.raises(BagError, match=r"messages on /map differ.*trimmed"):
        open_run(directory.path)
