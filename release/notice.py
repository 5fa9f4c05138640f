"""Write NOTICE: the licences of all crates whose code a wheel holds. With `--check`, say whether it is up to date."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
NOTICE = ROOT / "NOTICE"
# What .github/workflows/release.yml builds for: crates differ.
TARGETS = [
    "x86_64-unknown-linux-gnu",
    "aarch64-unknown-linux-gnu",
    "x86_64-unknown-linux-musl",
    "aarch64-unknown-linux-musl",
    "x86_64-apple-darwin",
    "aarch64-apple-darwin",
    "x86_64-pc-windows-msvc",
]
TEXTS = re.compile("LICEN[SC]E|COPYING|NOTICE")
HEAD = """\
mexpress is under the MIT licence: see LICENSE. Its native module is made of the Rust crates below too, each under
the licence that stands beside it, with its text further down; the address beside a crate has its source. Parts of
faer are from Eigen (Mozilla Public License 2.0), LAPACK and SuiteSparse (BSD licences). The module also holds
Rust's standard library (MIT or Apache-2.0: https://www.rust-lang.org/policies/licenses), and where zig linked it
LLVM's libunwind (Apache-2.0 WITH LLVM-exception: https://llvm.org/LICENSE.txt).

"""


def cargo(*arguments: str) -> str:
    """What cargo prints."""
    command = ["cargo", *arguments, "--locked", "--features", "python"]
    return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout


def linked() -> set[tuple[str, str]]:
    """Name and version of each crate in a wheel. Macros run while it is built, and are not in it."""
    targets = [f"--target={target}" for target in TARGETS]
    tree = cargo("tree", "--edges=normal,no-proc-macro", "--prefix=none", "--format={p}", *targets)
    return set(re.findall(r"^(\S+) v(\S+)", tree, re.MULTILINE))


def chosen(crate: dict[str, Any], allowed: list[str]) -> str:
    """Of the licences that a crate may be used under, the one that deny.toml names first."""
    offered = re.split(r" OR |/", crate["license"])
    if not set(offered) & set(allowed):
        raise SystemExit(f"{crate['name']} is under {crate['license']}, which deny.toml does not allow.")
    return min(set(offered) & set(allowed), key=allowed.index)


def texts(crate: dict[str, Any], licence: str) -> list[str]:
    """The texts in a crate's package that go with a licence; those called COPYING are of code that it took over."""
    folder = Path(crate["manifest_path"]).parent
    files = {
        file.name: plain(file.read_text()) for file in sorted(folder.iterdir()) if TEXTS.match(file.name)
    }
    copied = [text for name, text in files.items() if name.startswith("COPYING")]
    own = {name: text for name, text in files.items() if not name.startswith("COPYING")}
    if not own and licence == "MIT":
        terms = (ROOT / "LICENSE").read_text().split("\n\n", maxsplit=2)[2]
        return [plain(f"Copyright (c) {', '.join(crate['authors']) or crate['name']}\n\n{terms}"), *copied]
    if not own:
        raise SystemExit(f"{crate['name']} has no text of its licence, {licence}.")
    of_licence = f"LICENSE-{licence.partition('-')[0].upper()}"
    return [*([own[of_licence]] if of_licence in own else own.values()), *copied]


def plain(text: str) -> str:
    """A text without what editors leave at the ends of lines."""
    return "\n".join(line.rstrip() for line in text.strip().splitlines())


def notice() -> str:
    """Give a line for each crate, then each text once, under the crates that it belongs to."""
    allowed = tomllib.loads((ROOT / "deny.toml").read_text())["licenses"]["allow"]
    platforms = [f"--filter-platform={target}" for target in TARGETS]
    packages = json.loads(cargo("metadata", "--format-version=1", *platforms))["packages"]
    wanted = linked() - {
        ("mexpress", package["version"]) for package in packages if package["name"] == "mexpress"
    }
    crates = [package for package in packages if (package["name"], package["version"]) in wanted]
    lines, owners = [], dict[str, list[str]]()
    for crate in sorted(crates, key=lambda crate: (crate["name"], crate["version"])):
        title, licence = f"{crate['name']} {crate['version']}", chosen(crate, allowed)
        lines.append(f"{title:<26}{licence:<14}{crate['repository']}")
        for text in texts(crate, licence):
            owners.setdefault(text, []).append(title)
    parts = [f"{'-' * 100}\n{', '.join(titles)}\n\n{text}\n" for text, titles in owners.items()]
    return HEAD + "\n".join([*lines, "", *parts])


if __name__ == "__main__":
    if sys.argv[1:] == ["--check"]:
        if NOTICE.read_text() != notice():
            raise SystemExit(
                "NOTICE is not that of the crates in Cargo.lock. Run `make notice`, and look at what has changed."
            )
    else:
        NOTICE.write_text(notice())
