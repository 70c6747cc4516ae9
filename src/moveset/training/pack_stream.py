"""From run folders to a stream's model folder: the recurrent denoiser with its flow, its students and its baseline."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from torch import nn

from moveset.data.corpus import Corpus
from moveset.data.dataset import CorpusDataset
from moveset.data.feature_store import FeatureStore
from moveset.errors import InputError, exit_code_of
from moveset.pipelines.stream_bundle import DEFAULT_STREAM, FLOW, StreamConfig, save_stream_bundle
from moveset.text.vocabulary import words_of
from moveset.training import frozen
from moveset.training.pack import familiarity_limit, known_captions, trained_words
from moveset.training.reading import embedded
from moveset.training.stills import SENTENCES

RDM, MD = "rdm", "md"
#: Where ``moveset train`` leaves each network, below the folder of all runs.
RUNS = {RDM: "rdm-7", MD: "md-7", "pcm-1": "rdm-pcm-1", "pcm-2": "rdm-pcm-2", "pcm-4": "rdm-pcm-4"}


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """How a stream is sampled when nothing is asked for: fields of ``StreamConfig``, and its defaults."""

    network: str = RDM
    sampler_steps: int = StreamConfig.sampler_steps
    start: int = StreamConfig.start
    lag: int = StreamConfig.lag
    eta: float = StreamConfig.eta
    past_lag: int | None = StreamConfig.past_lag
    idle: str = StreamConfig.idle
    travelling: float = StreamConfig.travelling
    symmetric: tuple[str, ...] = StreamConfig.symmetric


def pack_stream(
    corpus_path: Path,
    cache: Path,
    runs: Mapping[str, Path | Sequence[Path]],
    guidance: Mapping[str, float],
    name: str,
    out: Path,
    sampling: Sampling | None = None,
    averaged: bool = True,
    differences: bool = True,
    smoothing: Mapping[str, float] | None = None,
) -> Path:
    """Write the model folder ``out``.

    Args:
        corpus_path: the corpus that the networks were trained on.
        cache: its folder of features and embedded captions.
        runs: run folder or checkpoint by name of the network: "rdm", from which the flow comes too, and any of "md",
            "pcm-1", "pcm-2" and "pcm-4".
        guidance: default guidance scale by name of the network.
        name: what the model is called.
        out: the folder to write.
        sampling: what a stream does by default.
        averaged: ship the students' averaged weights instead of the last ones; the others are always averaged.
        differences: store the students as 8-bit differences from "rdm", which they were started from.
        smoothing: of a network's output by its name, instead of that of its training; guidance makes it tremble.

    Raises:
        InputError: no "rdm", networks for other features, other segments or another number of steps, guidance or
            smoothing of a network that is not there, or a cache of another corpus.
    """
    if RDM not in runs:
        raise InputError(f"a stream needs the network {RDM!r}, got {', '.join(runs) or 'none'}; give its run folder")
    loaded: dict[str, frozen.Frozen] = {}
    provenance: dict[str, str] = {}
    of_student = "student_ema" if averaged else "student"
    for network in sorted(runs, key=lambda name: (name != RDM, name == MD)):
        parts = frozen.load_all(runs[network], of_student if network.startswith("pcm-") else "denoiser_ema")
        for found in parts:
            _check(network, found, loaded.get(RDM, found))
        provenance[network] = frozen.provenance(parts)
        loaded[network] = frozen.mean(network, parts)
    rdm, students = loaded[RDM], [network for network in runs if network.startswith("pcm-")]
    modules: dict[str, nn.Module] = {network: found.module for network, found in loaded.items()}
    for network, value in (smoothing or {}).items():
        if network not in modules:
            raise InputError(f"there is no network {network!r} to smooth; choose {', '.join(modules)}")
        modules[network].config = replace(modules[network].config, smoothing=value)  # type: ignore[assignment,type-var]
    if unknown := set(guidance) - set(modules):
        raise InputError(f"there is no network {sorted(unknown)[0]!r} to guide; choose {', '.join(modules)}")
    if rdm.task["flow"] is not None:
        modules[FLOW] = frozen.mean(FLOW, frozen.load_all(runs[RDM], "flow_ema", part="coupling_flow")).module
    points = {loaded[k].task["points"] for k in students} or {StreamConfig(name="", network="").points}
    if len(points) > 1:
        raise InputError(f"the students were distilled on grids of {sorted(points)} points; pack those of one grid")
    corpus, encoder = Corpus.open(corpus_path), rdm.task["text_encoder"]
    store = FeatureStore.cached(CorpusDataset(corpus), rdm.task["codec"], cache)
    known, words = known_captions(corpus), trained_words(corpus, rdm.task)
    if rdm.task["cutting"].get("stills"):
        known = sorted({*known, *SENTENCES})
        words |= {word for sentence in SENTENCES for word in words_of(sentence)}
    pooled = embedded(cache, encoder, known).pooled_of(known)
    config = StreamConfig(
        name=name,
        codec=rdm.task["codec"],
        text_encoder=encoder,
        guidance={network: guidance[network] for network in modules if network in guidance},
        far_prompt=familiarity_limit(pooled, encoder),
        provenance={
            "corpus": f"{len(corpus.indices(composed=False))} clips, {corpus.seconds / 3600:.2f} h",
            **provenance,
        },
        segment=rdm.task["grid"]["frames"],
        depth_cap=rdm.task["depth_cap"],
        points=points.pop(),
        **vars(Sampling() if sampling is None else sampling),
    )
    normalizer = {"feature_mean": store.normalizer.mean, "feature_std": store.normalizer.std}
    bases = dict.fromkeys(students, RDM) if differences else None
    return save_stream_bundle(out, config, modules, normalizer, known, pooled, bases, words)


def _check(network: str, found: frozen.Frozen, rdm: frozen.Frozen) -> None:
    """Raises InputError for a network that cannot share a folder with "rdm"."""
    for size in ("features", "frames", "text_dim"):
        if (ours := found.config[size]) != rdm.config[size]:
            raise InputError(f"{network!r} has {ours} {size} and {RDM!r} {rdm.config[size]}; pack networks of one kind")
    if network.startswith("pcm-") and (phases := found.task["phases"]) != int(network.removeprefix("pcm-")):
        raise InputError(f"{network!r} would be a student of {phases} phases; give it its own run folder")


def main() -> None:
    """Command line: ``python -m moveset.training.pack_stream --runs runs/small --out FOLDER``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--runs", type=Path, default=Path("runs/small"))
    parser.add_argument("--corpus", type=Path, default=Path("data/corpus.safetensors"))
    parser.add_argument("--networks", nargs="*", default=list(RUNS), help="which of them to pack; 'rdm' always is")
    parser.add_argument(
        "--folder",
        nargs="*",
        default=[],
        metavar="NETWORK=FOLDER[,FOLDER]",
        help="a run folder below --runs of another name, or several, whose mean is packed",
    )
    parser.add_argument(
        "--guidance", nargs="*", default=["1.5"], metavar="[NETWORK=]W", help="one scale for all, or one by network"
    )
    parser.add_argument("--network", default=Sampling.network, help="the default network")
    parser.add_argument("--steps", type=int, default=Sampling.sampler_steps, help="K of the networks but students")
    parser.add_argument("--start", type=int, default=Sampling.start, help="R")
    parser.add_argument("--lag", type=int, default=Sampling.lag)
    parser.add_argument(
        "--past-lag", type=int, help="steps that a finished segment is told to be ahead; clean if not given"
    )
    parser.add_argument("--eta", type=float, default=Sampling.eta)
    parser.add_argument("--idle", default=Sampling.idle, help="the prompt of a stream that was given none")
    parser.add_argument(
        "--smoothing", nargs="*", default=[], metavar="[NETWORK=]C", help="of their output; as trained by default"
    )
    parser.add_argument("--last", action="store_true", help="the students' last weights instead of the averaged ones")
    parser.add_argument("--whole", action="store_true", help="the students' weights, not differences from rdm's")
    parser.add_argument("--symmetric", nargs="*", default=[], help="guided networks to be sampled with mirror images")
    parser.add_argument(
        "--travelling", type=float, default=Sampling.travelling, help="share by which the root of whoever goes is held"
    )
    parser.add_argument("--name", default=DEFAULT_STREAM)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    if unknown := set(given.networks) - set(RUNS):
        raise InputError(f"a stream has no network {sorted(unknown)[0]!r}; choose from {', '.join(RUNS)}")
    networks = tuple(dict.fromkeys((RDM, *given.networks)))
    pairs = dict(pair.partition("=")[::2] for pair in given.folder)
    if useless := [network for network, folder in pairs.items() if network not in networks or not folder]:
        raise InputError(f"--folder {useless[0]} is no NETWORK=FOLDER of {', '.join(networks)}, which are packed")
    folders = RUNS | pairs
    runs = {network: [given.runs / folder for folder in folders[network].split(",")] for network in networks}
    sampling = Sampling(
        network=given.network,
        sampler_steps=given.steps,
        start=given.start,
        lag=given.lag,
        eta=given.eta,
        past_lag=given.past_lag,
        idle=given.idle,
        travelling=given.travelling,
        symmetric=tuple(given.symmetric),
    )
    scales, smoothing = (by_network(chosen, networks) for chosen in (given.guidance, given.smoothing))
    cache = given.runs / "cache"
    averaged, differences = not given.last, not given.whole
    made = pack_stream(
        given.corpus, cache, runs, scales, given.name, given.out, sampling, averaged, differences, smoothing
    )
    print(made)


def by_network(given: list[str], networks: tuple[str, ...]) -> dict[str, float]:
    """Numbers by network, from "X" for all of them and "NETWORK=X" for one.

    >>> by_network(["1.5", "pcm-1=2"], ("rdm", "pcm-1"))
    {'rdm': 1.5, 'pcm-1': 2.0}

    Raises:
        InputError: no number.
    """
    numbers: dict[str, float] = {}
    for item in given:
        network, equals, number = item.rpartition("=")
        try:
            value = float(number)
        except ValueError:
            raise InputError(f"{item!r} has no number; write NUMBER or NETWORK=NUMBER, such as 1.5") from None
        numbers |= {network: value} if equals else dict.fromkeys(networks, value)
    return numbers


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
