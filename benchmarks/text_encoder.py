"""Round all-MiniLM-L6-v2 to 8 bits as it ships, and say what the rounding costs on sentences.

python benchmarks/text_encoder.py FOLDER --out src/moveset/weights/minilm
python benchmarks/text_encoder.py FOLDER --sentences data/raw/humanml3d-cmu.jsonl

FOLDER is that of ``sentence-transformers/all-MiniLM-L6-v2``: config.json, model.safetensors and tokenizer.json.
"""

import json
import shutil
import sys
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor
from torch.nn.functional import cosine_similarity, normalize

from arguments import Parser
from moveset.errors import exit_code_of
from moveset.io.quantization import rounded
from moveset.text.minilm import PACKAGED, MiniLM

# Of matrices 32 columns share a unit; of words, positions and types, which do not add up over layers, a whole row.
BLOCK, WIDTH = 32, 384


def main() -> None:
    """See the module."""
    parser = Parser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--sentences", type=Path)
    given = parser.parse_args()
    if given.out:
        given.out.mkdir(parents=True, exist_ok=True)
        save_file(as_shipped(load_file(given.folder / "model.safetensors")), given.out / "model.safetensors")
        shutil.copyfile(given.folder / "tokenizer.json", given.out / "tokenizer.json")
    if given.sentences:
        with given.sentences.open(encoding="utf-8") as lines:
            sentences = sorted({text for line in lines for text in json.loads(line)["sentences"]}, key=len)
        print(json.dumps(cost(sentences, given.folder, given.out or PACKAGED), indent=1))


def as_shipped(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """All that the encoder reads: matrices rounded, norms and biases whole."""
    stored: dict[str, Tensor] = {}
    for name, value in state.items():
        if value.ndim == 1:
            stored[name] = value
        elif name.startswith("embeddings") and value.is_floating_point():
            stored |= rounded(name, value, WIDTH)
        elif name.startswith("encoder"):
            stored |= rounded(name, value, BLOCK)
    return {name: value for name, value in stored.items() if not name.startswith("pooler")}


@torch.inference_mode()
def cost(sentences: list[str], whole: Path, folder: Path) -> dict[str, float]:
    """Cosine distances from what ``transformers`` computes with the whole weights, and agreement in retrieval."""
    from transformers import AutoTokenizer, BertModel

    ours, bert = MiniLM(folder, max_tokens=512), BertModel.from_pretrained(whole, attn_implementation="eager").eval()
    tokenizer = AutoTokenizer.from_pretrained(whole)
    tokens, found, expected = [], [], []
    for begin in range(0, len(sentences), 64):
        mine = ours.encode(sentences[begin : begin + 64])
        inputs = tokenizer(sentences[begin : begin + 64], padding=True, return_tensors="pt")
        theirs = bert(**inputs).last_hidden_state
        tokens.append(1 - cosine_similarity(mine.tokens[mine.mask], theirs[mine.mask], dim=-1))
        found.append(mine.pooled)
        expected.append(normalize((theirs * mine.mask[:, :, None]).sum(1), dim=-1))
    a, b = torch.cat(found), torch.cat(expected)
    pooled, states = 1 - cosine_similarity(a.double(), b.double(), dim=-1), torch.cat(tokens)
    near_a, near_b = (rows @ rows.T - 2 * torch.eye(len(rows)) for rows in (a, b))
    chosen = near_a.argmax(1)
    lost = near_b.amax(1) - near_b[torch.arange(len(b)), chosen]
    return {
        "sentences": len(sentences),
        "pooled_mean": float(pooled.mean()),
        "pooled_max": float(pooled.max()),
        "tokens_mean": float(states.mean()),
        "tokens_max": float(states.max()),
        "same_nearest_percent": 100 * float((chosen == near_b.argmax(1)).float().mean()),
        # By the whole weights: how much less like the sentence the one is that was found instead of the nearest.
        "similarity_lost_max": float(lost.max()),
    }


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
