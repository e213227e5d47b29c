"""A page that follows a folder: served while a run is at work, renewed when its files change."""

from hashlib import sha256
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Lock
from typing import Any

from dropo.core.services.errors import BadArgument, InvalidInput
from dropo.report.build import page_of
from dropo.report.folder import read_result

EVERY = 3
"""Seconds after which a browser asks whether something changed."""
FOLLOW = """
<noscript><meta http-equiv="refresh" content="%(every)d"></noscript>
<p class="live" role="status"></p>
<script>
// Asks every few seconds whether the folder changed; a page that is renewed stays where it was.
const told = document.querySelector(".live");
setInterval(async () => {
  try {
    const tag = await (await fetch("tag", { cache: "no-store" })).text();
    if (tag !== "%(tag)s") location.reload();
    told.textContent = "";
  } catch {
    told.textContent = "No answer: `dropo report --serve` has ended, or cannot be reached.";
  }
}, %(every)d000);
</script>
</body>"""


class LivePage:
    """The page of a folder as it is now, made anew only where files changed.

    Parameters
    ----------
    folder : Path
        Of a run, at work or finished.

    Raises
    ------
    BadFile
        If the folder holds nothing that a page can be made of.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self._lock = Lock()
        self._tag = ""
        self._text = ""
        text = page_of(read_result(folder))
        self._keep(self.tag(), text)

    def tag(self) -> str:
        """Return a text that changes with the folder's files.

        Returns
        -------
        str
        """
        seen = []
        for path in sorted(self.folder.iterdir()):
            try:
                found = path.stat()
            except OSError:  # gone since
                continue
            if path.is_file() and ".part" not in path.name:
                seen.append((path.name, found.st_size, found.st_mtime_ns))
        return sha256(repr(seen).encode()).hexdigest()[:16]

    def text(self) -> str:
        """Return the page.

        Returns
        -------
        str
            The last one that could be made, while files are being written.
        """
        with self._lock:
            tag = self.tag()
            if tag != self._tag:
                try:
                    self._keep(tag, page_of(read_result(self.folder)))
                except InvalidInput:
                    self._tag = ""
            return self._text

    def _keep(self, tag: str, text: str) -> None:
        """Keep a page, which asks whether its tag is still that of the folder."""
        follow = FOLLOW % {"every": EVERY, "tag": tag}
        self._text = text.replace("</body>", follow)
        self._tag = tag


def live_server(folder: Path, host: str, port: int) -> ThreadingHTTPServer:
    """Make a server of a folder's page; `serve_forever` runs it.

    Parameters
    ----------
    folder : Path
        Of a run, at work or finished. Nothing is written there.
    host : str
        The address at which it listens.
    port : int
        The port; 0 for any that is free.

    Returns
    -------
    ThreadingHTTPServer

    Raises
    ------
    BadFile
        If the folder holds nothing that a page can be made of.
    BadArgument
        If the address or the port cannot be had.
    """
    page = LivePage(folder)

    class Handler(BaseHTTPRequestHandler):
        """Answers with the page, and with the tag by which a browser sees that it changed."""

        def do_GET(self) -> None:
            """Answer."""
            path = self.path.partition("?")[0]
            if path == "/":
                self._answer(page.text(), "text/html")
            elif path == "/tag":
                self._answer(page.tag(), "text/plain")
            else:
                self.send_error(HTTPStatus.NOT_FOUND)

        def _answer(self, text: str, kind: str) -> None:
            """Send a text."""
            content = text.encode()
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", f"{kind}; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *arguments: Any) -> None:
            """Print nothing of each request."""

    try:
        server = ThreadingHTTPServer((host, port), Handler)
    except (OSError, OverflowError, UnicodeError) as error:
        raise BadArgument(
            f"--serve: {host} port {port} cannot be had: {error}. Give another port, such as "
            f"--serve {port + 1 if port < 65535 else 8000}, or leave out --host."
        ) from None
    server.daemon_threads = True
    return server
