"""Install a wheel or an sdist into empty environments, with the oldest numpy and with the newest, and use it there."""

import subprocess
import sys
import tempfile
import tomllib
import venv
from pathlib import Path

HERE = Path(__file__).parent


def oldest_numpy() -> str:
    """The requirement of pyproject.toml, turned into the oldest release that meets it."""
    (requirement,) = tomllib.loads((HERE.parent / "pyproject.toml").read_text())["project"]["dependencies"]
    return f"{requirement.replace('>=', '==')}.*"


def wheel_of(sdist: Path, folder: Path) -> Path:
    """What pip builds from an sdist, in an environment of its own."""
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, sdist],
        check=True,
    )
    (wheel,) = folder.glob("mexpress-*.whl")
    return wheel


def install_and_use(wheel: Path, numpy: str, folder: Path) -> None:
    """Use a wheel where neither other packages nor this repository can be imported."""
    venv.create(folder, with_pip=True)
    python = folder / "bin/python"
    # An sdist of numpy would be compiled for minutes: the interpreter is too new for the oldest numpy.
    subprocess.run(
        [python, "-m", "pip", "install", "--quiet", "--only-binary=numpy", wheel, numpy], check=True
    )
    subprocess.run([python, "-I", HERE / "use.py"], cwd=folder, check=True)


if __name__ == "__main__":
    package = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as scratch:
        wheel = package if package.suffix == ".whl" else wheel_of(package, Path(scratch))
        for requirement in [oldest_numpy(), "numpy"]:
            install_and_use(wheel, requirement, Path(scratch) / requirement)
