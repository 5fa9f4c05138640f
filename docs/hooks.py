"""What the site has besides the pages of docs/: README and its neighbours, and the help of the command line."""

import contextlib
import io
import re
from pathlib import Path

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

from mexpress.cli import main

ROOT = Path(__file__).parents[1]
BESIDE = {"README.md": "index.md", "CHANGELOG.md": "CHANGELOG.md", "CONTRIBUTING.md": "CONTRIBUTING.md"}
"""Files beside docs/, and what they are in the site."""

COPIED = ["CITATION.cff", "examples/selection.ipynb"]
"""Files that pages lead to."""


def on_files(files, config):
    """Add the files beside docs/."""
    for name, page in BESIDE.items():
        files.append(File.generated(config, page, content=from_root((ROOT / name).read_text())))
    for name in COPIED:
        files.append(File.generated(config, name, content=(ROOT / name).read_text()))
    return files


def from_root(text):
    """Return the text of a file beside docs/ with its links as the site has them."""
    text = text.replace("](docs/", "](")
    return re.sub(r"\]\(([A-Z]+\.md)", lambda link: f"]({BESIDE[link[1]]}", text)


def on_page_markdown(markdown, page, config, files):
    """Make links to files beside docs/ lead to their pages, and put in the help of commands."""
    markdown = re.sub(
        r"\]\(((?:\.\./)*)\.\./([A-Z]+\.md)", lambda link: f"]({link[1]}{BESIDE[link[2]]}", markdown
    )
    return re.sub(
        r"^<!-- (mexpress.*) -->$", lambda command: output(command[1]), markdown, flags=re.MULTILINE
    )


def output(command):
    """Return what a command prints, as a block."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        main(command.split()[1:])
    return f"```text\n{printed.getvalue().strip()}\n```"


def on_post_page(output, page, config):
    """Refuse a page that loads something from elsewhere: the site opens without a network."""
    loaded = re.findall(r"""<(?:script|img|iframe)[^>]*\ssrc="?((?:https?:)?//[^"\s>]+)""", output)
    loaded += re.findall(r"""<link(?![^>]*rel="?canonical)[^>]*\shref="?((?:https?:)?//[^"\s>]+)""", output)
    if loaded:
        raise PluginError(f"{page.file.src_uri} loads {loaded[0]}")
    return output
