"""The video inside a page, with a caption that says what is enlarged and slowed down."""

import base64
from html import escape

import numpy as np

from dropo.report.folder import Media
from dropo.report.page import paragraph, plain
from dropo.report.robot.video import Shown


def told(shown: Shown, again: str, both: bool) -> str:
    """Say what a video shows.

    Parameters
    ----------
    shown : Shown
        What is enlarged, and how quick it is.
    again : str
        Which run it is, and how predictions start again.
    both : bool
        Whether there are two models.

    Returns
    -------
    str
    """
    halves = "above as simulated before (orange), below after (blue)"
    if not both:
        halves = "in both halves as simulated by the one model"
    size = "Errors are as large as they are."
    if shown.factor > 1:
        size = f"Errors are enlarged {shown.factor} times, so that they are seen."
    pace = {0: "", 1: " In its own time."}.get(shown.slowed, f" {shown.slowed} times slower.")
    part = f" Shown are {plain(shown.seconds, 3)} s." if np.isfinite(shown.seconds) else ""
    return f"Grey is the robot as measured, {halves}. {size}{pace}{part} {again}".rstrip()


def video_part(media: Media | None) -> str:
    """Show the video, or say how to get it.

    Parameters
    ----------
    media : Media or None
        What was rendered for the page.

    Returns
    -------
    str
        HTML.
    """
    if media is None:
        return paragraph(
            "No video was made: `dropo report DIR --video` renders the robot as measured and as "
            "simulated, where the model is at hand (extra `video`)."
        )
    data = base64.b64encode(media.video).decode()
    return (
        '<figure class="video"><video controls muted loop playsinline preload="auto" '
        f'aria-label="{escape(media.told)}" src="data:video/mp4;base64,{data}"></video>'
        f"<figcaption>{escape(media.told)}</figcaption></figure>"
    )
