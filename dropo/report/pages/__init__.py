"""The pages, one file for each kind of folder.

A page is a function from a `Result` to the HTML file's text, and a line in `PAGES` of `build`.
"""
