"""The server: REST for clips, a WebSocket for streams, and the page that shows both. Needs the extra ``serve``."""
