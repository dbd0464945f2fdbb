"""A ``std_srvs/srv/Trigger`` on a DDS domain, by which a robot asks to keep the time around now.

ROS 2 has no services on DDS, only a pair of topics. Which call a reply belongs to is in front of
the message by Cyclone DDS's implementation of ROS 2 [1]_, and beside it by the others. Python
has no access to the latter, so only clients of the former get an answer.

References
----------
.. [1] https://github.com/ros2/rmw_cyclonedds, ``cdds_request_header_t``
"""

from typing import Any

from rosbags.interfaces import Nodetype, QosDurability
from rosbags.typesys.store import Typestore

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.discovery import ENTITIES_QOS

REQUEST, REPLY = "std_srvs/srv/Trigger_Request", "std_srvs/srv/Trigger_Response"
_CALL = {"client": "uint64", "number": "int64"}
_FIELDS = {
    REQUEST: {**_CALL, "structure_needs_at_least_one_member": "uint8"},
    REPLY: {**_CALL, "success": "bool", "message": "string"},
}
_TYPES: Any = {
    name: ([], [(field, (Nodetype.BASE, (base, 0))) for field, base in fields.items()])
    for name, fields in _FIELDS.items()
}
TYPES = Typestore()
TYPES.register(_TYPES)
QOS = ENTITIES_QOS._replace(durability=QosDurability.VOLATILE)


class TriggerService:
    """Takes the calls of a service, and answers each.

    Parameters
    ----------
    participant
        Owner of its endpoints.
    name : str
        Of the service, such as ``/oracle/keep``.
    """

    def __init__(self, participant: dds.Participant, name: str) -> None:
        self._requests = dds.RawReader(participant, f"rq{name}Request", REQUEST, QOS, TYPES)
        self._replies = dds.RawWriter(participant, f"rr{name}Reply", REPLY, QOS, TYPES)

    def calls(self) -> int:
        """Answer the calls since the last time, and return their number."""
        calls = self._requests.take()
        reply: Any = TYPES.types[REPLY]
        for call in calls:
            asked: Any = TYPES.deserialize_cdr(call.data, REQUEST)
            answer = reply(asked.client, asked.number, True, "The time around now is kept.")
            self._replies.write(bytes(TYPES.serialize_cdr(answer, REPLY)))
        return len(calls)
