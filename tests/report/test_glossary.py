"""Words are explained where they stand."""

import re
from pathlib import Path

from dropo.report.glossary import WORDS, explained, list_of, meaning

DOCS = Path(__file__).parents[2] / "docs" / "report.md"


def test_the_first_of_each_word_is_marked():
    """With its plural, once; not inside code, pictures, headings or other words."""
    silent = "<h3>nats</h3><svg><text>nats</text></svg>"
    html = f"{silent}<p>Nats and nats, a nation; <code>sd</code> sd.</p>"
    marked = explained(html)
    found = re.findall(r'<abbr class="word" tabindex="0" title="([^"]*)">([^<]*)</abbr>', marked)
    assert [text for _, text in found] == ["Nats", "sd"]
    assert found[0][0] == WORDS["nat"]
    assert re.sub(r"</?abbr[^>]*>", "", marked) == html


def test_a_list_of_what_a_page_uses():
    """Also words in pictures and heads of tables; none, no list."""
    listed = list_of("<svg><text>nats gained</text></svg><th>p-value</th>")
    assert re.findall("<dt>([^<]*)</dt>", listed) == ["nat", "p-value"]
    assert list_of("<p>Nothing.</p>") == ""
    assert meaning("standard error of nats") == WORDS["standard error"]
    assert meaning("mass") == ""


def test_the_documentation_has_the_same_sentences():
    """Each word with its sentence in docs/report.md."""
    text = " ".join(DOCS.read_text().split())
    missing = [word for word, says in WORDS.items() if f"**{word}**: {says}" not in text]
    assert missing == []
