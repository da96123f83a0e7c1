"""Network addresses of clients."""

from __future__ import annotations

import ipaddress


def network(address: str) -> str:
    """Network that counts as one client: an IPv4 address, or the /64 from which an IPv6 host chooses its addresses."""
    try:
        found = ipaddress.ip_address(address)
    except ValueError:
        return address
    if isinstance(found, ipaddress.IPv6Address):
        if found.ipv4_mapped is not None:
            return str(found.ipv4_mapped)
        return str(ipaddress.ip_network((int(found) >> 64 << 64, 64)))
    return str(found)
