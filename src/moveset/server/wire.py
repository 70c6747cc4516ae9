"""Motion on the wire: the packets of ``moveset.io.packets``, as the body of requests and the frames of sockets."""

from moveset.io.packets import CONTACTS as CONTACTS
from moveset.io.packets import HEADER as HEADER
from moveset.io.packets import pack_packet as pack_packet
from moveset.io.packets import skeleton_json as skeleton_json
from moveset.io.packets import unpack_packets as unpack_packets

MEDIA_TYPE = "application/octet-stream"
