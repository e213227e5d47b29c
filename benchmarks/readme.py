"""Tables in the page of the benchmarks."""

import re
from pathlib import Path

from dropo.core.services.files.atomic_write import write_text

README = Path(__file__).with_name("README.md")


def write_block(name: str, text: str) -> str:
    """Put a table into the README between `<!-- name -->` and `<!-- end -->`; give the block."""
    block = f"<!-- {name} -->\n{text}\n<!-- end -->"
    pattern = rf"<!-- {name} -->.*?<!-- end -->"
    page = re.sub(pattern, lambda _: block, README.read_text(), flags=re.DOTALL)
    write_text(README, page)
    return block
