"""Features of runs: the plugins, their manager, and the tables of features.

A plugin needs only the names in this module.
"""

from oracle_pipeline.features.adapters.thesis import FeatureExtractionPlugin
from oracle_pipeline.features.engine.plugin import (
    Feature,
    FeaturePlugin,
    Located,
    Missing,
    PluginError,
    RawRecord,
    Request,
    Series,
    Window,
    hookimpl,
)
from oracle_pipeline.features.engine.tables import FeatureTables, RecordingFeatures, Table, together
from oracle_pipeline.features.extraction import compute, extract, measure, write
from oracle_pipeline.features.manager import FeatureManager, build_manager

__all__ = [
    "Feature", "FeatureExtractionPlugin", "FeatureManager", "FeaturePlugin", "FeatureTables",
    "Located", "Missing", "PluginError", "RawRecord", "RecordingFeatures", "Request", "Series",
    "Table", "Window", "build_manager", "compute", "extract", "hookimpl", "measure", "together",
    "write",
]  # fmt: skip
