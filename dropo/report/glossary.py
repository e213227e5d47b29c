"""The words of a page that not every engineer uses, each with a sentence: their only home."""

import re
from html import escape

WORDS = {
    "nat": "Unit of log-likelihood: one nat more, and the data are 2.7 times as likely.",
    "log-likelihood": "How well a model predicts the measurements, noise and all [nats]; more is "
    "better, and only differences mean anything.",
    "held out": "Kept apart: data that no fit has seen, which alone say how good a model is.",
    "standard error": "How far an estimate is likely off, since data are finite: the truth is "
    "within two of them in 95 of 100 cases.",
    "95 % interval": "Holds the true number in 95 of 100 cases, if the model is right.",
    "p-value": "The chance of a result like this, or a stronger one, where there is nothing.",
    "sd": "Standard deviation: how much a parameter itself varies from draw to draw, however well "
    "its mean is known.",
    "root mean square": "The usual size of an error: the square root of the mean of its squares.",
    "spread": "How much a signal varies in the data: its standard deviation without noise.",
    "control step": "The time for which one command is held.",
    "transition": "A measured state, the command then, and the next measured state.",
    "effect": "Something that a simulation may lack, such as dry friction at one joint.",
    "cause": "An effect that was confirmed on data held out.",
    "residual": "Measured less predicted: what a model leaves over.",
    "calibration": "Whether predictions are as sure as they should be: of ten measurements nine "
    "lie inside a band of 90 %.",
    "horizon": "How many control steps lie between a measured start and what is predicted.",
    "epsilon": "The variance of a signal's noise, also written ε.",
    "lambda": "How many control steps a fit predicts ahead before it compares, also written λ.",
    "search interval": "From the lowest to the highest value that a parameter may have.",
    "prior": "What was known of a parameter before these data.",
    "correlation": "Between two parameters, from -1 to 1: near either end the data tell only both "
    "together, and one may be off if the other is.",
    "contour": "A line that holds a given share of the draws.",
    "identify": "Data identify a parameter if another value of it would have moved differently.",
    "emulator": "A quick formula that stands for the simulator near the estimate.",
    "regression": "A fit of forces at measured motions, which simulates nothing.",
    "inverse dynamics": "The forces that a measured motion needs, by the model's masses.",
    "walker": "One of the chains that draw from a posterior.",
    "split R-hat": "Compares halves of chains: near 1 where all draw from the same distribution.",
    "effective sample size": "How many independent draws the draws are worth.",
    "autocorrelation time": "After how many draws a chain has forgotten where it was.",
    "MJCF": "MuJoCo's format of models, an XML file.",
}
"""Word to sentence."""
FORMS = {"identify": r"identif(?:y|ies|ied)", "p-value": r"p-values?"}
"""Patterns of words whose forms are no plain plurals."""
SILENT = {"svg", "pre", "code", "script", "select", "button", "h2", "h3", "abbr", "summary", "dt"}
"""Tags inside which no word is marked."""
TAG = re.compile(r"(<[^>]*>)")


def explained(html: str) -> str:
    """Mark each word where it stands first, so that a hover or a tap says what it means.

    Parameters
    ----------
    html : str
        A part of a page.

    Returns
    -------
    str
    """
    known = set(WORDS)
    silent: list[str] = []
    parts = TAG.split(html)
    for k, part in enumerate(parts):
        if part.startswith("<"):
            _enter(silent, part)
        elif not silent and part.strip():
            parts[k] = _marked(part, known)
    return "".join(parts)


def _enter(silent: list[str], tag: str) -> None:
    """Keep the open tags inside which no word is marked."""
    name = re.match(r"</?([a-z0-9]*)", tag)
    assert name is not None
    if name[1] not in SILENT or tag.endswith("/>"):
        return
    if tag.startswith("</"):
        silent.pop()
    else:
        silent.append(name[1])


def _marked(text: str, known: set[str]) -> str:
    """Text with the words that were not marked before; what is marked is taken from the known."""
    places = []
    for word in sorted(known):
        found = pattern(word).search(text)
        if found:
            places.append((found.start(), found.end(), word))
    out = ""
    end = 0
    for start, stop, word in sorted(places):
        if start < end:
            continue
        known.discard(word)
        says = escape(WORDS[word])
        out += text[end:start]
        out += f'<abbr class="word" tabindex="0" title="{says}">{text[start:stop]}</abbr>'
        end = stop
    return out + text[end:]


def pattern(word: str) -> re.Pattern[str]:
    """Make the pattern of a word of the glossary and its plural.

    Parameters
    ----------
    word : str
        The word.

    Returns
    -------
    re.Pattern
        Which ignores case, but for "MJCF" and "sd".
    """
    form = FORMS.get(word, re.escape(word) + "s?")
    return re.compile(rf"(?<![\w-]){form}(?![\w-])", 0 if word in ("MJCF", "sd") else re.IGNORECASE)


def meaning(text: str) -> str:
    """Find the sentence of the first word of the glossary in a text.

    Parameters
    ----------
    text : str
        The text.

    Returns
    -------
    str
        The sentence; empty without such a word.
    """
    found = [(hit.start(), word) for word in WORDS if (hit := pattern(word).search(text))]
    return WORDS[min(found)[1]] if found else ""


def list_of(html: str) -> str:
    """List the words that a page uses anywhere, with their sentences.

    Parameters
    ----------
    html : str
        The page's content.

    Returns
    -------
    str
        HTML; empty where it uses none.
    """
    text = TAG.sub(" ", re.sub(r"<(script|style).*?</\1>", " ", html, flags=re.DOTALL))
    used = sorted((word for word in WORDS if pattern(word).search(text)), key=str.casefold)
    items = "".join(f"<dt>{escape(word)}</dt><dd>{escape(WORDS[word])}</dd>" for word in used)
    if not used:
        return ""
    return f'<details class="words"><summary>Words on this page</summary><dl>{items}</dl></details>'
