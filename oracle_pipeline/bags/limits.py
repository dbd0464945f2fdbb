"""Limits far beyond real recordings, at which a broken or hostile one is refused.

Every limit is named in the error that it causes. With all of them, a recording of up to 200 MB on
disk is read, and its features are computed, in at most 1 GiB of memory (`tools/soak/memory.py`).
"""

from typing import Final

_MIB = 2**20

#: Bytes of one chunk or record, decompressed. rosbag2 writes chunks of 0.8 to 4 MB.
LARGEST_CHUNK: Final = 128 * _MIB
#: Messages of a recording over all topics; and bytes on disk per message, which allow more.
MOST_MESSAGES, SMALLEST_MESSAGE = 8_000_000, 24
#: Topics and publishers of one recording.
MOST_CHANNELS: Final = 10_000
#: Largest ratio of decompressed to compressed size of a file.
LARGEST_EXPANSION: Final = 200
#: Bytes, depth and values of ``metadata.yaml`` or of QoS profiles.
LARGEST_YAML, DEEPEST_YAML, MOST_YAML_VALUES = 16 * _MIB, 24, 1_000_000
#: Bytes of the text that defines a message type, and fields when all types in it are unfolded.
LARGEST_DEFINITION, MOST_FIELDS = _MIB // 2, 100_000
#: Bytes that may be held to merge messages in order of time.
LARGEST_DISORDER: Final = 256 * _MIB
#: Bytes of one message that is decoded, and of all that features keep of messages.
LARGEST_DECODED, MOST_KEPT = 64 * _MIB, 448 * _MIB
#: Windows of one recording.
MOST_WINDOWS: Final = 100_000
#: Bytes and depth of the XML of a graph.
LARGEST_GRAPH, DEEPEST_GRAPH = 64 * _MIB, 24
