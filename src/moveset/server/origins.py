"""Origins, spelled as browsers send them."""

import re

from moveset.errors import InputError

# A scheme and a host without a path, a scheme alone (file://), or "null" for pages without a site.
_ORIGIN = re.compile(r"null|[a-z][a-z0-9+.-]*://[^/?#@\s]*", re.ASCII)
_SITE = re.compile(r"(https?)://(\[[0-9a-f:.]+\]|[^:\[\]]+)(?::(\d{1,5}))?", re.ASCII)
_PORTS = {"http": 80, "https": 443}  # which browsers leave out


def as_sent(origin: str) -> str:
    """An origin as a browser's header has it: origins are compared to the letter.

    Raises:
        InputError: what no browser sends.

    >>> as_sent("HTTPS://Game.Example:443/"), as_sent("http://localhost:8080"), as_sent("app://Studio")
    ('https://game.example', 'http://localhost:8080', 'app://Studio')
    """
    scheme, separator, rest = origin.partition("://")
    found = scheme.lower() + separator + rest
    if scheme.lower() in _PORTS:
        # Hosts of other schemes are kept as they are. An address as it is copied from a browser has a slash at its end.
        found = found.lower().removesuffix("/")
    if "*" in found:
        raise InputError(f"{origin!r} is no origin: browsers send no *; name each site by an --allow-origin")
    if _ORIGIN.fullmatch(found) is None:
        raise InputError(
            f"{origin!r} is no origin; give a scheme and a host, such as https://example.org, or what a program's own "
            "pages say: null, file:// or app://name"
        )
    if not found.isascii():
        raise InputError(
            f"{origin!r} is not in ASCII, in which browsers send names; give its form with xn--, as location.origin "
            "says it in their consoles"
        )
    return _without_port(found, origin) if scheme.lower() in _PORTS else found


def _without_port(found: str, origin: str) -> str:
    """A site's origin, without a port that goes without saying."""
    site = _SITE.fullmatch(found)
    if site is None or int(site[3] or 1) not in range(1, 65_536):
        raise InputError(
            f"{origin!r} is no origin; give a scheme, a host and, where it is not the usual one, a port of 1 to 65535, "
            "such as https://example.org:8443"
        )
    port = int(site[3] or _PORTS[site[1]])
    return f"{site[1]}://{site[2]}" + (f":{port}" if port != _PORTS[site[1]] else "")
