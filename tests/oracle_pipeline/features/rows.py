"""Messages as columns, for tests."""

from typing import Any

from oracle_pipeline.bags.types import serialize, typestore
from oracle_pipeline.features.engine.columns import Batch, Columns


def batch_of(*messages: Any) -> Batch:
    """Return messages of one type as they are read from a bag."""
    msgtype = messages[0].__msgtype__
    return Batch([serialize(m, msgtype) for m in messages], typestore(), msgtype, is_cdr=True)


def columns_of(*messages: Any) -> Columns:
    """Return messages of one type as though they were one."""
    return batch_of(*messages).columns()
