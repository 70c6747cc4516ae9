"""What goes wrong, said to a client: a status, a code for programs and a sentence for people."""

from typing import Any

from moveset.errors import InputError, MovesetError

_LONGEST = 600  # characters of a message


class RequestError(Exception):
    """A request that cannot be answered.

    Args:
        status: of HTTP.
        code: a word for programs.
        message: one sentence: value, limit, remedy.
        retry_after: seconds after which to try again, if that helps.
    """

    def __init__(self, status: int, code: str, message: str, retry_after: int | None = None) -> None:
        super().__init__(message)
        self.status, self.code, self.retry_after = status, code, retry_after
        self.message = sayable(message)

    def body(self) -> dict[str, Any]:
        return {"error": {"code": self.code, "message": self.message}}

    def headers(self) -> dict[str, str]:
        return {} if self.retry_after is None else {"Retry-After": str(self.retry_after)}


def sayable(message: str) -> str:
    """The message, not too long and without what cannot be sent: it may quote what a client wrote.

    >>> sayable("half a character: " + chr(0xD83D)).isascii()
    True
    """
    return message[:_LONGEST].encode("utf-8", "backslashreplace").decode()


def told(error: MovesetError) -> RequestError:
    """What a client is told of an error: its own mistake, or trouble of the server such as a full disk."""
    if isinstance(error, InputError):
        return RequestError(400, "invalid", str(error))
    return RequestError(500, "internal", str(error))


def busy(what: str, limit: int) -> RequestError:
    return RequestError(503, "busy", f"{limit} {what} are in work, which is the limit; try again in a moment", 2)


def cancelled() -> RequestError:
    return RequestError(409, "cancelled", "this job was cancelled; send it again if it is still wanted")


def stopping() -> RequestError:
    return RequestError(503, "stopping", "the server is stopping; try again when it is back", 5)
