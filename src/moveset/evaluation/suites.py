"""Which models, with which settings, are the rows of the papers' tables; and running them one after the other.

A row names a model folder, one of its networks, and how it is sampled. Folders are found by the name in their
``config.json``: those that ship, and any that are given. A row whose weights are not there stays in the table and says
so. Folders given that no row of any suite asks for become rows of their own, but for those of judges.

N segments, K sampler steps, R steps that a later segment takes (``rdm.staircase``).
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from moveset.errors import FormatError, InputError
from moveset.io.manifest import json_object
from moveset.pipelines.model_folder import shipped
from moveset.pipelines.role import Role, is_student, named

CLIPS, STREAMS = "motionpcm-small", "rdm-small"
REAL, TRAINING, NEAREST, RECONSTRUCTION = "real", "training", "nearest", "vae"
DENOISERS = (Role.DENOISER, Role.AUTOREGRESSIVE, Role.STUDENT)
# Repeats of rows that cost ten times as much as others: what others are compared with, the rest, and settings alone.
MORE, FEW, FEWER = 10, 5, 3

Setting = str | int | float


@dataclass(frozen=True, kw_only=True)
class Row:
    """A row of a table.

    Args:
        key: its name in files.
        label: its name in the table.
        group: what it stands under.
        model: name of a model folder, or REAL, TRAINING or NEAREST.
        network: of that folder; RECONSTRUCTION is its autoencoder alone. None where there is no folder.
        steps: K; None where nothing is sampled.
        settings: of the sampler, where they are not the folder's: start, lag, past_lag, shape, init_noise, guidance,
            eta, variance, eps_scale, time_shift, stages.
        repeats: at most so many, for rows that cost much more than others.
        against: keys of the rows that it is compared with.
    """

    key: str
    label: str
    group: str
    model: str
    network: str | None = None
    steps: int | None = None
    settings: Mapping[str, Setting] = field(default_factory=dict)
    repeats: int | None = None
    against: Sequence[str] = ()

    @property
    def ranked(self) -> bool:
        """Whether it takes part in best and second best: what samples does."""
        return self.steps is not None

    def times(self, asked: int) -> int:
        return min(asked, self.repeats or asked)


@dataclass(frozen=True)
class Suite:
    """A table.

    Args:
        name: of the published tables too.
        references: keys of the rows that folders given besides are compared with.
        seams: seconds between the places where real motion's jerk is measured as at seams; 0 for none.
    """

    name: str
    title: str
    rows: tuple[Row, ...]
    references: tuple[str, ...]
    seams: float = 0.0


def get_suite(name: str) -> Suite:
    """A suite by name.

    Raises:
        InputError: no such suite.

    >>> [row.label for row in get_suite("motionpcm").rows][:2]
    ['Real', 'Real, of the training']
    """
    if name not in _SUITES:
        raise InputError(f"{name!r} is no suite; there are {', '.join(_SUITES)}")
    return _SUITES[name]()


# How well the judge knows by heart what it was trained on, and what copying would give: read other rows beside them.
_REFERENCES = (
    Row(key="real", label="Real", group="Reference", model=REAL),
    Row(key="training", label="Real, of the training", group="Reference", model=TRAINING),
    Row(key="nearest", label="Nearest training clip", group="Reference", model=NEAREST),
)


def motionpcm() -> Suite:
    """Text to clips: MotionPCM's Table 1, and its ablations (Table 2)."""
    held = ("teacher", "lcm-1")
    full = Row(
        key="teacher",
        label="Teacher, 50 guided steps",
        group="Diffusion",
        model=CLIPS,
        network="teacher",
        steps=50,
        repeats=FEW,
    )
    student = Row(key="", label="", group="", model=CLIPS, against=held)
    rows = [
        *_REFERENCES,
        Row(key="vae", label="VAE, reconstruction", group="Reference", model=CLIPS, network=RECONSTRUCTION),
        full,
        replace(full, key="mld", label="MLD-style, one latent token, 50 guided steps", model="mld-small",
                against=("teacher",)),
        *(
            replace(student, key=f"lcm-{n}", label=f"LCM, {plural(n, 'step')}", group="Consistency model",
                    network="lcm-1", steps=n)
            for n in (1, 2, 4)
        ),
        *(
            replace(student, key=f"pcm-{n}", label=f"PCM, {plural(n, 'step')}", group="MotionPCM", network=f"pcm-{n}",
                    steps=n)
            for n in (1, 2, 4)
        ),
        *(
            replace(student, key=key, label=f"PCM, 1 step, {what}", group="Ablations, trained like PCM, 1 step",
                    model=f"motionpcm-{key}-small", network="pcm-1", steps=1, against=("pcm-1",))
            for key, what in (
                ("k20", "k = 20"), ("no-ema", "without EMA"), ("no-discriminator", "without discriminator"),
            )
        ),
    ]  # fmt: skip
    return Suite("motionpcm", "MotionPCM: text to clips", tuple(rows), held)


def rdm() -> Suite:
    """Streams and what they are compared with: RDM's Tables 1 to 3, and its ablations (Tables 4 and 5)."""
    stream = Row(
        key="", label="", group="Recurrent", model=STREAMS, network="rdm", steps=10, repeats=FEW, against=("md-7",)
    )
    staircase = replace(stream, group="RDM-7, how far segments overlap", repeats=FEWER, against=("rdm-7",))
    # By the recipe "small", so that no row has learned longer than another.
    alike = replace(stream, group="Every variant, shown as many frames of motion as RDM-7", against=("md-7", "rdm-7"))
    volume = replace(alike, network="denoiser")
    # A segment enters one step after the one before it and goes through all of its own: best on validation items.
    entangled = {"start": 10, "lag": 1}

    def overlapping(key: str, what: str, start: int, shape: str) -> Row:
        settings = {"start": start, "lag": 1, "shape": shape}
        return replace(staircase, key=key, label=f"RDM-7, {what}", settings=settings)

    rows = [
        *_REFERENCES,
        replace(stream, key="md-7", label="MD-7", group="Autoregressive", model="md-7-small", network="md",
                repeats=MORE, against=()),
        replace(stream, key="md-7-alone", label="MD-7, told nothing of the past", group="Autoregressive",
                model="md-7-alone-small", network="md", against=("md-7",)),
        replace(stream, key="rdm-7", label="RDM-7, overlapping (R = K)", settings=entangled, repeats=MORE,
                against=("md-7", "md-7-alone")),
        replace(stream, key="rdm-pcm-1", label="RDM-7's student, 1 step", network="pcm-1", steps=1, repeats=None,
                against=("md-7", "rdm-7")),
        replace(stream, key="rdm-pcm-2", label="RDM-7's student, 2 steps", model="rdm-2-steps-small", network="pcm-2",
                steps=2, repeats=None, against=("md-7", "rdm-7", "rdm-pcm-1")),
        replace(stream, key="whole-sentences", label="RDM-7's student, 1 step, whole sentences", network="pcm-1",
                steps=1, settings={"stages": False}, against=("rdm-pcm-1",)),
        # What a student is to be better than: the model itself in as few steps.
        *(
            replace(stream, key=f"rdm-steps-{k}", label=f"RDM-7 as it ships, in {plural(k, 'step')}", steps=k,
                    against=("noisy-past", "rdm-pcm-1"))
            for k in (5, 2, 1)
        ),
        overlapping("disentangled", "R = 0 (the flow alone)", 0, "parallelogram"),
        overlapping("triangle-1", "R = 1, triangle", 1, "triangle"),
        overlapping("triangle-2", "R = 2, triangle", 2, "triangle"),
        overlapping("triangle-7", "R = 7 = N, triangle", 7, "triangle"),
        overlapping("parallelogram-4", "R = 4, parallelogram", 4, "parallelogram"),
        replace(staircase, key="sequential", label="RDM-7, one segment after the other, told a clean past",
                settings={"start": 10, "lag": 10, "past_lag": 10}, repeats=FEW, against=("md-7", "rdm-7")),
        replace(staircase, key="noisy-past", label="RDM-7 as it ships: one segment after the other, told a noisy past",
                settings={"start": 10, "lag": 10, "past_lag": 1}, repeats=FEW, against=("md-7", "rdm-7", "sequential")),
        replace(volume, key="rdm-1", label="RDM-1", model="rdm-1-small"),
        replace(volume, key="light-rdm-1", label="Light-RDM-1", model="light-rdm-1-small"),
        replace(volume, key="motiondiffuse", label="MotionDiffuse", model="motiondiffuse-small"),
        replace(volume, key="dip", label="DiP", model="dip-small"),
        replace(alike, key="md-4", label="MD-4", model="md-4-small", network="md"),
        replace(alike, key="rdm-4", label="RDM-4", model="rdm-4-small", settings=entangled),
        replace(alike, key="rdm-14", label="RDM-14", model="rdm-14-small", settings=entangled),
    ]  # fmt: skip
    return Suite("rdm", "RDM: motion without end", tuple(rows), ("md-7", "rdm-7"), seams=28 / 20)


_SUITES: dict[str, Callable[[], Suite]] = {"motionpcm": motionpcm, "rdm": rdm}


def chosen_rows(
    name: str, given: Sequence[Path] = (), only: Sequence[str] = (), *, alone: bool = False
) -> list[tuple[Row, Path | None, str]]:
    """The rows that were asked for, each with what ``find_weights`` says of it.

    Args:
        name: "motionpcm" or "rdm".
        given: model folders besides those that ship; one with a shipped one's name takes its place.
        only: keys of rows; all if empty.
        alone: without those that ship.

    Raises:
        InputError: no such suite or row, two folders of one name, or a folder that is none.
        FormatError: a damaged folder.
    """
    folders = named_folders(given)
    rows = [*get_suite(name).rows, *extra_rows(get_suite(name), folders)]
    if unknown := set(only) - {row.key for row in rows}:
        raise InputError(f"suite {name!r} has no row {sorted(unknown)[0]!r}; it has {', '.join(r.key for r in rows)}")
    own = {} if alone else shipped()
    return [(row, *find_weights(row, folders, own)) for row in rows if not only or row.key in only]


def find_weights(row: Row, folders: Mapping[str, Path], own: Mapping[str, Path]) -> tuple[Path | None, str]:
    """The model folder of a row, and why it cannot be evaluated: "" if it can.

    Raises:
        FormatError: a damaged folder.
    """
    if row.model in (REAL, TRAINING, NEAREST):
        return None, ""
    folder = folders.get(_stem(row.model)) or own.get(row.model)
    if folder is None:
        return None, "no weights given"
    if row.network not in networks(folder):
        return None, f"not in {row.model}"
    return folder, ""


def named_folders(paths: Sequence[Path]) -> dict[str, Path]:
    """Model folders by the name in their configuration, without that of their recipe.

    Raises:
        InputError: no model folder, or two of one name.
        FormatError: a damaged configuration.
    """
    found: dict[str, Path] = {}
    for path in paths:
        if not (path / "config.json").is_file():
            raise InputError(
                f"{path} is no model folder: it has no config.json; give one that moveset train export wrote"
            )
        name = _stem(str(_config(path).get("name", path.name)))
        if name in found:
            raise InputError(f"{found[name]} and {path} are both called {name!r}; give one of them another name")
        found[name] = path
    return found


def networks(folder: Path) -> tuple[str, ...]:
    """Names of the networks of a model folder.

    Raises:
        FormatError: a damaged configuration, or that of something else, such as a checkpoint of a training.
    """
    models = _config(folder).get("models")
    if not isinstance(models, dict):
        raise FormatError(f"{folder / 'config.json'} names no models; give one that moveset train export wrote")
    return tuple(models)


def extra_rows(suite: Suite, folders: Mapping[str, Path]) -> list[Row]:
    """Rows for folders that no row asks for, one for each of their denoisers, in the folder's order.

    What another suite's rows ask for is no row of this one, and a judge is none: all folders of a recipe may be given.
    """
    asked = {_stem(row.model) for make in _SUITES.values() for row in make().rows}
    return [
        given_row(suite, name, network, own_steps(path, network))
        for name, path in folders.items() if name not in asked and _config(path).get("task") != "evaluator"
        for network in networks(path) if named(network).role in DENOISERS
    ]  # fmt: skip


def own_steps(folder: Path, network: str) -> int:
    """In how many steps a network of a model folder is sampled where nobody says.

    Raises:
        FormatError: a damaged configuration.
    """
    if (steps := named(network).steps) is not None:
        return steps
    # Of clips no folder says it: the teacher's are the published ones.
    steps = _config(folder).get("sampler_steps", 50)
    if not isinstance(steps, int):
        raise FormatError(f"{folder / 'config.json'} has sampler_steps {steps!r}, which is no number of steps")
    return steps


def given_row(suite: Suite, model: str, network: str, steps: int | None) -> Row:
    """The row of a network that a suite does not know."""
    return Row(
        key=f"{model}-{network}", label=f"{model}, {network}", group="Others given", model=model, network=network,
        steps=steps, repeats=None if is_student(network) else FEW, against=suite.references,
    )  # fmt: skip


def _stem(name: str) -> str:
    """The name of a model without its recipe's: models of all recipes stand in the same rows.

    >>> _stem("rdm-small"), _stem("rdm-paper"), _stem("mine")
    ('rdm', 'rdm', 'mine')
    """
    return re.sub(r"-(small|paper|tiny)$", "", name)


def _config(folder: Path) -> dict:
    return json_object((folder / "config.json").read_bytes(), folder / "config.json")


def plural(count: int, what: str) -> str:
    """So many of them.

    >>> plural(1, "group"), plural(2, "group")
    ('1 group', '2 groups')
    """
    return f"{count} {what}{'s' * (count != 1)}"
