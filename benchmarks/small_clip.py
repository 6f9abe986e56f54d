"""A small CLIP with random weights, made on the spot: LeRobot's policies that read with one then need no download.

`python -m benchmarks.small_clip data/small_clip --dataset data/mt10_states` knows the words of this dataset's tasks.
Nothing in it is trained, so sentences are told apart and no more: those that mean the same are no nearer than others.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import torch
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from tokenizers import Tokenizer
from tokenizers.models import WordLevel
from tokenizers.normalizers import Lowercase
from tokenizers.pre_tokenizers import Whitespace
from tokenizers.processors import TemplateProcessing
from transformers import CLIPTextConfig, CLIPTextModel, PreTrainedTokenizerFast

_PADDING, _START, _UNKNOWN, _END = 0, 1, 2, 3  # 2 as the end of a sentence means something else to CLIP
_SIZE = {"hidden_size": 64, "num_hidden_layers": 1, "num_attention_heads": 2, "intermediate_size": 128}


def save_small_clip(folder: Path, sentences: Sequence[str], seed: int = 0) -> None:
    """Write the half that reads, and its tokenizer: a token for each word of `sentences`."""
    torch.manual_seed(seed)
    tokenizer = _tokenizer(sentences)
    config = CLIPTextConfig(
        vocab_size=len(tokenizer),
        pad_token_id=_PADDING,
        bos_token_id=_START,
        eos_token_id=_END,
        initializer_factor=2.0,  # else all sentences are nearly the same
        **_SIZE,
    )
    CLIPTextModel(config).save_pretrained(folder)
    tokenizer.save_pretrained(folder)


def _tokenizer(sentences: Sequence[str]) -> PreTrainedTokenizerFast:
    special = ["[pad]", "[start]", "[unknown]", "[end]"]
    split = Whitespace().pre_tokenize_str(" ".join(sentences).lower())
    words = dict.fromkeys([*special, *(word for word, _ in split)])
    tokenizer = Tokenizer(WordLevel({word: number for number, word in enumerate(words)}, unk_token="[unknown]"))
    tokenizer.normalizer, tokenizer.pre_tokenizer = Lowercase(), Whitespace()
    tokenizer.post_processor = TemplateProcessing(
        single="[start] $A [end]", special_tokens=[("[start]", _START), ("[end]", _END)]
    )
    return PreTrainedTokenizerFast(
        tokenizer_object=tokenizer,
        pad_token="[pad]",
        bos_token="[start]",
        unk_token="[unknown]",
        eos_token="[end]",
        model_max_length=77,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="must have clip in its name: LeRobot asks for it")
    parser.add_argument("--dataset", type=Path, required=True, help="folder of the dataset whose tasks it reads")
    options = parser.parse_args()
    tasks = LeRobotDatasetMetadata("local/any", root=options.dataset).tasks
    save_small_clip(options.folder, list(tasks.index))
