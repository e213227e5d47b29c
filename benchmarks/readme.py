"""Tables in the page of the benchmarks."""

import json
import re
from pathlib import Path
from typing import Any

from dropo.core.services.files.atomic_write import write_text

README = Path(__file__).with_name("README.md")
NUMBERS = re.compile(r"<!-- numbers (.*) -->")


def write_block(name: str, text: str) -> str:
    """Put a table into the README between `<!-- name -->` and `<!-- end -->`; give the block."""
    block = f"<!-- {name} -->\n{text}\n<!-- end -->"
    pattern = rf"<!-- {name} -->.*?<!-- end -->"
    page = re.sub(pattern, lambda _: block, README.read_text(), flags=re.DOTALL)
    write_text(README, page)
    return block


def numbers(found: dict[str, Any]) -> str:
    """A line that a page does not show, from which `numbers_in` reads what was measured."""
    return f"<!-- numbers {json.dumps(found)} -->"


def numbers_in(text: str) -> dict[str, Any]:
    """What was measured, from the output of a benchmark; nothing where it says nothing."""
    found = NUMBERS.search(text)
    return {} if found is None else dict(json.loads(found[1]))


def read_kept(path: Path) -> dict[str, Any]:
    """What a benchmark has kept in a file of JSON; nothing where there is none yet."""
    return dict(json.loads(path.read_text())) if path.exists() else {}
