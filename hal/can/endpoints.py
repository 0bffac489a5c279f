"""How to reach a bus: python-can's own terms, or one line of text that an emulator gives out.

socketcand://HOST:PORT/CHANNEL   classic CAN between processes
udp_multicast://GROUP:PORT       CAN-FD between processes; every member hears its own frames too
virtual://CHANNEL                inside one process
slcan:///dev/pts/N               a serial adapter
"""

from typing import Any
from urllib.parse import urlsplit

from core.errors import InputError

EMULATED_AS = ("socketcand", "udp_multicast", "virtual", "slcan")
ECHOING = ("udp_multicast",)
ENDPOINT = "endpoint"


def endpoint_arguments(endpoint: str, *, bitrate: int, fd: bool) -> dict[str, Any]:
    """Keywords for `can.Bus` from a line of text."""
    scheme, _, rest = endpoint.partition("://")  # with an underscore it is no scheme to urlsplit
    try:
        parts = urlsplit(f"can://{rest}")
        host, port = parts.hostname or "", parts.port or 0
    except ValueError as error:
        raise InputError(f"cannot be read: {error}", where="endpoint", got=endpoint) from error
    match scheme:
        case "socketcand" if host and port:
            return {"interface": "socketcand", "host": host, "port": port, "channel": parts.path.strip("/") or "can0"}
        case "udp_multicast" if host and port:
            return {"interface": "udp_multicast", "channel": host, "port": port, "hop_limit": 0, "fd": fd}
        case "virtual" if host:
            return {"interface": "virtual", "channel": parts.netloc, "protocol": _protocol(fd)}
        case "slcan" if parts.path:
            return {"interface": "slcan", "channel": parts.path, "bitrate": bitrate, "sleep_after_open": 0.0}
    kinds = "socketcand://HOST:PORT/CHANNEL, udp_multicast://GROUP:PORT, virtual://CHANNEL, slcan:///DEVICE"
    raise InputError("endpoint", got=endpoint, expected=kinds)


def _protocol(fd: bool) -> Any:
    from can import CanProtocol

    return CanProtocol.CAN_FD if fd else CanProtocol.CAN_20
