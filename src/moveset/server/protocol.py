"""What clients may send, validated strictly: unknown fields, wrong types and numbers out of range are refused."""

import json
import re
import unicodedata
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from moveset.pipelines.request import MAX_GUIDANCE, SEEDS
from moveset.server.failures import sayable
from moveset.server.limits import Limits

LIMITS = Limits()
_SPACE = {"\t", "\n", "\r"}
_SHOWN = 40  # characters of a value that an error quotes
_TYPES = "start, prompt, played, pause, resume, set, stop"
NO_JSON = "what was sent is no JSON that can be read; send an object in UTF-8, see /docs"
_SAID = {
    "missing": "this is missing; /docs lists what is needed",
    "extra_forbidden": "there is no such field; leave it out, or see /docs",
    "string_too_short": "this is empty; fill it in, or leave it out",
    "model_type": "this should be an object; see /docs",
    "model_attributes_type": "this should be an object; see /docs",
    "union_tag_not_found": f"a message has a type; choose one of {_TYPES}",
    "union_tag_invalid": f"there is no message {{tag!r}}; choose one of {_TYPES}",
}


def plain(text: str) -> str:
    """A sentence in one line.

    Raises:
        ValueError: control characters, halves of characters, or nothing at all.

    >>> plain(" a person\\nwalks ")
    'a person walks'
    """
    if any(unicodedata.category(c) in ("Cc", "Cs") and c not in _SPACE for c in text):
        raise ValueError("a prompt contains control characters; give plain text")
    text = " ".join(text.split())
    if not text:
        raise ValueError("the prompt is empty; describe a motion, such as 'a person walks forward and waves'")
    return text


Prompt = Annotated[str, Field(min_length=1, max_length=LIMITS.prompt), AfterValidator(plain)]
Seed = Annotated[int, Field(ge=0, lt=SEEDS)]
# No model has more; how many the one has that is asked, the catalog knows.
Steps = Annotated[int, Field(ge=1, le=1000, description="at most the model's own, which /v1/models tells")]
Guidance = Annotated[float, Field(ge=0.0, le=MAX_GUIDANCE, allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1, max_length=64)]
Buffer = Annotated[float, Field(ge=LIMITS.buffer[0], le=LIMITS.buffer[1], allow_inf_nan=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class ClipPrompt(_Strict):
    """A sentence, and for how long; without seconds the text decides."""

    text: Prompt
    seconds: Annotated[float, Field(gt=0.0, le=LIMITS.seconds, allow_inf_nan=False)] | None = None


class GenerateBody(_Strict):
    """A clip to be made: prompts that follow one another."""

    prompts: Annotated[list[ClipPrompt], Field(min_length=1, max_length=LIMITS.prompts)]
    model: Name | None = None
    steps: Steps | None = None
    guidance: Guidance | None = None
    seed: Seed | None = None
    num: Annotated[int, Field(ge=1, le=LIMITS.variants)] = 1
    format: Annotated[str, Field(max_length=16)] = "json"
    fps: Annotated[float, Field(ge=1.0, le=240.0, allow_inf_nan=False)] | None = None
    skeleton: Name | None = None
    in_place: bool = False
    loop: bool = False


class Start(_Strict):
    """Begin a stream."""

    type: Literal["start"]
    prompt: Prompt | None = None
    model: Name | None = None
    seed: Seed | None = None
    steps: Steps | None = None
    guidance: Guidance | None = None
    buffer: Buffer = 2.0
    commit: Annotated[int, Field(ge=0, le=10_000)] | None = None


class ChangePrompt(_Strict):
    """Go on with another prompt."""

    type: Literal["prompt"]
    text: Prompt


class Played(_Strict):
    """All frames before this one were played."""

    type: Literal["played"]
    frame: Annotated[int, Field(ge=0, le=2**53)]


class Set(_Strict):
    """Change how the stream is made."""

    type: Literal["set"]
    buffer: Buffer | None = None
    steps: Steps | None = None
    guidance: Guidance | None = None


class Plain(_Strict):
    """A message that says all by its type."""

    type: Literal["pause", "resume", "stop"]


StreamMessage = Annotated[Start | ChangePrompt | Played | Set | Plain, Field(discriminator="type")]
_MESSAGES: TypeAdapter[StreamMessage] = TypeAdapter(StreamMessage)


def read_message(text: str) -> Start | ChangePrompt | Played | Set | Plain:
    """A message of a stream's client.

    Raises:
        ValueError: none that is known; one sentence.
    """
    try:
        return _MESSAGES.validate_json(text)
    except ValidationError as error:
        raise ValueError(sentence(error.errors(include_url=False))) from None


def sentence(errors: list[dict]) -> str:
    """The first thing that is wrong, in one sentence.

    Args:
        errors: as pydantic lists them.
    """
    first = errors[0]
    kind, given = first["type"], first.get("input")
    where = ".".join(str(part) for part in first["loc"] if part != "body")
    what = str(first["msg"]).removeprefix("Value error, ")
    if kind == "json_invalid":
        where, what = "", NO_JSON
    elif kind in _SAID:
        what = _SAID[kind].format(**first.get("ctx", {}))
    elif kind == "string_too_long":
        what = f"{len(given or '')} characters are more than the limit of {first['ctx']['max_length']}; say it shorter"
    elif given is not None:
        # "-1 should be greater than or equal to 0": the value as it was sent, and its limit.
        what = re.sub("^(Input|String|List)(?= should)", lambda _: _shown(given), what)
    return sayable(f"{where}: {what}" if where else what)


def _shown(given: object) -> str:
    text = json.dumps(given, ensure_ascii=False, default=str)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"
