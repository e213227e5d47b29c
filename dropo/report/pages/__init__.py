"""The pages, one file for each kind of folder.

They may import `core`, `plots`, `diagnosis.findings`, `diagnosis.parts` and the other parts of
`report`. To add one, write a function from a `Result` to the HTML file's text, and add a line to
`PAGES` of `build`.
"""
