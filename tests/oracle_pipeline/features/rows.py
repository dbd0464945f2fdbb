"""Messages as columns, for tests."""

from typing import Any

from oracle_pipeline.bags.types import serialize, typestore
from oracle_pipeline.features.engine.columns import Columns, SerializedMessages


def batch_of(*messages: Any) -> SerializedMessages:
    """Return messages of one type as they are read from a bag."""
    msgtype = messages[0].__msgtype__
    data = [serialize(message, msgtype) for message in messages]
    return SerializedMessages(data, typestore(), msgtype, is_cdr=True)


def columns_of(*messages: Any) -> Columns:
    """Return messages of one type as though they were one."""
    return batch_of(*messages).columns()
