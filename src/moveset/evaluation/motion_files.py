"""A folder of motions with prompts, whatever system made them: ``NAME.npy`` joints and what each was told.

Prompts stand in ``NAME.txt`` beside each file (first line; text files of HumanML3D will do), or in one JSONL file as
``moveset generate --prompts`` takes it, where "name" names the file: ``NAME.npy``, ``…-NAME.npy``, or ``…-NAME-0.npy``
and so on where several were made of it. Several prompts, one after the other, are judged by one sentence, as rollouts
are.
F frames, J joints; metres, Y up.
"""

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from moveset.data.humanml3d import Caption, parse_caption
from moveset.data.listing import read_listing
from moveset.errors import FormatError, InputError
from moveset.evaluation.generators import resampled
from moveset.evaluation.samples import Item, TestSet, text_of
from moveset.io.limits import read_limited
from moveset.io.numpy_file import read_array
from moveset.motion.features import get_codec
from moveset.motion.hml import HmlCodec

LIST = "prompts.jsonl"
MIN_FRAMES = 5
#: Metres that all bones of a body are long together: a grown one's are 5, and broken motion has some leeway. Joints in
#: centimetres, or of nobody, would be judged without an error.
BONES = (0.5, 50.0)


def folder_motions(folder: Path, prompts: Path | None, fps: float) -> TestSet:
    """The motions of a folder as items that are judged by their own prompts.

    Args:
        folder: of ``.npy`` files (F, J, 3).
        prompts: JSONL file; None for ``prompts.jsonl`` in the folder if it is there, else text files.

    Raises:
        InputError: no files, a file without a prompt, or joints of another shape.
        FormatError: a damaged file, or positions that are not finite.
    """
    features = get_codec("hml")
    assert isinstance(features, HmlCodec)
    if not folder.is_dir():
        raise InputError(f"there is no folder {str(folder)!r}; give a folder of .npy joint positions")
    if not 1 <= fps <= 1000:
        raise InputError(f"frame rate {fps:g} is not in 1 to 1000; give that of the motions, such as 20")
    files = sorted(folder.glob("*.npy"))
    if not files:
        raise InputError(f"{folder} holds no .npy files; give joint positions (frames, {len(features.skeleton)}, 3)")
    listed = _listed(prompts or folder / LIST) if prompts or (folder / LIST).is_file() else None
    sha = hashlib.sha256()
    items = []
    for path in files:
        caption = _beside(path) if listed is None else _named(path, listed)
        joints = _joints(path, features, fps)
        sha.update(f"{path.name}\0{caption}\0".encode())
        sha.update(joints.numpy().tobytes())
        items.append(_item(path.stem, joints, caption, features))
    return TestSet(tuple(items), folder.resolve().name, sha.hexdigest(), features)


def _item(name: str, joints: Tensor, caption: Caption | str, codec: HmlCodec) -> Item:
    text = text_of(caption)
    return Item(
        name=name,
        rows=len(joints) - 1,
        captions=(caption,),
        # Two motions of one prompt are never told apart.
        label=(words(text) or text,),
        take=None,
        codec=codec.name,
        features=lambda: codec.encode_world([joints])[0],
        joints=lambda: joints,
    )


def _joints(path: Path, codec: HmlCodec, fps: float) -> Tensor:
    joints, count = read_array(path), len(codec.skeleton)
    if joints.ndim != 3 or tuple(joints.shape[1:]) != (count, 3):
        raise InputError(
            f"{path} holds {tuple(joints.shape)}, not joints (frames, {count}, 3); give joints in HumanML3D's order"
        )
    if not torch.isfinite(joints).all():
        raise FormatError(f"{path} holds NaN or infinite positions; nothing can be judged, so repair or remove it")
    joints = resampled(joints, fps, codec.fps)
    if len(joints) < MIN_FRAMES:
        raise InputError(f"{path} has {len(joints)} frames at {codec.fps:g} fps; at least {MIN_FRAMES} can be judged")
    parents = codec.skeleton.parents
    bones = joints[:, 1:] - joints[:, list(parents[1:])]
    if not BONES[0] <= (long := float(bones.double().norm(dim=-1).sum(-1).median())) <= BONES[1]:
        raise InputError(
            f"{path} holds a body whose bones are {long:.3g} long in all, not {BONES[0]:g} to {BONES[1]:g} m; give "
            "joints in metres and in HumanML3D's order"
        )
    return joints


def words(text: str) -> str:
    """A prompt without case and punctuation, in any alphabet; numbers stay.

    >>> words("A person jumps 3 times."), words("ひとが、歩く。")
    ('a person jumps 3 times', 'ひとが 歩く')
    """
    return " ".join(re.findall(r"[\w'-]+", text.casefold()))


def _beside(path: Path) -> Caption | str:
    text = path.with_suffix(".txt")
    if not text.is_file():
        raise InputError(f"{path.name} has no prompt; write it to {text.name}, or all prompts to {LIST}")
    try:
        lines = [line.strip() for line in read_limited(text, 2**20).decode("utf-8-sig").split("\n") if line.strip()]
    except UnicodeDecodeError:
        raise FormatError(f"{text} is not UTF-8 text; save it as UTF-8") from None
    if not lines:
        raise InputError(f"{text} is empty; write the prompt of {path.name} to it")
    if lines[0].count("#") != 3:
        return lines[0]
    try:
        return parse_caption(lines[0])
    except FormatError as error:
        raise FormatError(f"{text}: {error}") from None


def _listed(path: Path) -> dict[str, str]:
    prompts: dict[str, str] = {}

    def read(number: int, entry: dict[str, Any]) -> None:
        prompt, name = entry["prompt"], str(entry.get("name", f"{number:06d}"))
        said = prompt if isinstance(prompt, list) else [prompt]
        if not said or not all(isinstance(text, str) and text.strip() for text in said):
            raise TypeError("its prompt is neither a text nor a list of texts")
        if name in prompts:
            raise ValueError(f"{name!r} was named before")
        prompts[name] = then([text.strip() for text in said])

    read_listing(path, read, 'a JSON object with "prompt" and "name"')
    return prompts


def then(texts: Sequence[str]) -> str:
    """One sentence of several that follow one another.

    >>> then(["A person walks.", "He waves"])
    'A person walks, then he waves'
    """
    if len(texts) == 1:
        return texts[0]
    first, *rest = (text.rstrip(". ") for text in texts)
    return ", then ".join([first, *(text[:1].lower() + text[1:] for text in rest)])


def _named(path: Path, prompts: dict[str, str]) -> str:
    """The prompt whose name says most of the file's: "a-b" rather than "b", and of two that say as much the whole."""
    bits = path.stem.split("-")
    ends = ["-".join(bits[k:]) for k in range(len(bits))]
    fitting = [(len(end), True, end) for end in ends if end in prompts]
    if bits[-1].isdecimal():
        fitting += [(len(end), False, name) for end in ends if (name := end.rpartition("-")[0]) in prompts]
    if not fitting:
        raise InputError(f"{path.name} has no prompt; add a line with its name to the list of prompts")
    return prompts[max(fitting)[-1]]
