"""Scenes that two images show, with what is known of the truth: simulated, or the reader's own.

A reader's directory holds a scene, or several, each known by the name of its file of matches:

=====================================  ===============================================================================
``NAME.csv`` (.txt, .npz, .npy)        matches x1 y1 x2 y2 in pixels, as `mexpress.io.matches` reads them; no wrong ones
``NAME_source_contour.csv`` (.txt)     optional: closed polygon x y around an object in the source image
``NAME_target_contour.csv`` (.txt)     the same object's polygon in the target image, corners and their number at will
``NAME_source_mask.png``               instead of a contour: an image of the source's size, nonzero on the object
``NAME_target_mask.png``               instead of a contour, of the target's size
``NAME_source.png``, ``_target.png``   optional: the images, which figures are drawn on (.jpg and .jpeg too)
``scenes.json``                        optional: ``{"NAME": {"kind": "flat", "image_size": [800, 640],``
                                       ``"target_size": [800, 640], "homography": [[...], [...], [...]]}}``
=====================================  ===============================================================================

Where there is a scenes.json, only the scenes that it names are read. The kind is flat, rigid or deformable. Sizes are
those of the masks or images if not given; where a contour is known, the target's must be. The homography maps source
pixels to target pixels, and is the truth where it is given: it also gives the target's contour if there is no other.

Examples
--------
>>> scene = Simulated("flat", "affine")
>>> scene.name, scene.draw(51, seed=0).source.shape
('flat-affine', (51, 2))
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress import simulation
from mexpress._validation import Floats
from mexpress.io.images import read_image
from mexpress.io.matches import read_matches, read_points
from mexpress.paper.contours import Rings, outlines, rasterised, resampled
from mexpress.placement import covered_region, lattice
from mexpress.simulation.scenes import KINDS

SIZES = (51, 103, 206)
"""Numbers of matches in the paper's experiment."""

_FEWEST = 15
"""Matches that a scene must have: NN10PTS and KF10 hold out ten of them, or a tenth."""

_STEP = 2.0
"""Pixels from one point of a contour to the next, between which a warp is taken to be straight."""

_TRUTH = 2000
"""Points at which a warp is compared to a homography."""

_LARGEST = 2**28
"""Pixels of an image that contours are compared in."""

_INSIDE = 0.5
"""Share of the matches that must lie in an image: of fewer its size is another image's."""

_TABLES, _TEXTS, _IMAGES = (".csv", ".txt", ".npz", ".npy"), (".csv", ".txt"), (".png", ".jpg", ".jpeg")
_PARTS = ("_source_contour", "_target_contour", "_source_mask", "_target_mask", "_source", "_target")


@dataclass(frozen=True, eq=False)
class Problem:
    """Matches to fit a warp to, and what it is judged by.

    Parameters
    ----------
    source, target : (n, 2) array
        Matches, in pixels.
    unseen_source, unseen_target : (k, 2) array
        Points that should be mapped to each other, none of them fitted; maybe none.
    source_contour, target_contour : tuple of (c, 2) arrays
        Rings of the same region in both images; empty if unknown.
    image_size : (width, height) or None
        Of the source image in pixels.
    target_size : (width, height)
        Of the target image in pixels.
    """

    source: Floats
    target: Floats
    unseen_source: Floats
    unseen_target: Floats
    source_contour: Rings
    target_contour: Rings
    image_size: tuple[float, float] | None
    target_size: tuple[float, float]


@dataclass(frozen=True)
class Simulated:
    """A sheet in two simulated images, see `mexpress.simulation.scene`: with every seed another one.

    Parameters
    ----------
    kind : {"flat", "rigid", "deformable"}
        What the sheet does.
    projection : {"affine", "perspective"}
        What the cameras do.

    Examples
    --------
    >>> Simulated("rigid", "affine").draw(51, seed=0).target_contour[0].shape
    (400, 2)
    """

    kind: str
    projection: str

    @property
    def name(self) -> str:
        """What tables and files call it."""
        return f"{self.kind}-{self.projection}"

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers of matches to try."""
        return SIZES

    def repeats(self, n: int, wanted: int) -> int:
        """Return how many different draws of n matches to make: any number."""
        return wanted

    def draw(self, n: int, seed: int) -> Problem:
        """Return a problem with n matches, noise of 1 px on each; the truth is without noise.

        Examples
        --------
        >>> Simulated("flat", "perspective").draw(51, seed=3).image_size
        (1920.0, 1080.0)
        """
        views = simulation.scene(self.kind, self.projection, n, seed=seed)
        contours = (views.contour_source, views.contour_target)
        first, second = ((ring,) if ring is not None else () for ring in contours)
        truth = (views.dense_source, views.dense_target, first, second)
        return Problem(views.source, views.target, *truth, views.image_size, views.image_size)


@dataclass(frozen=True, eq=False)
class Recorded:
    """A scene of the reader's; see the module for its files, `read_scenes` for reading it.

    Parameters
    ----------
    name, kind : str
        What it is called; flat, rigid, deformable, or nothing if unknown.
    source, target : (n, 2) array
        All matches.
    source_contour, target_contour : tuple of (c, 2) arrays
        Rings, empty if unknown.
    image_size : (width, height) or None
        Of the source image in pixels.
    target_size : (width, height)
        Of the target image in pixels.
    homography : (3, 3) array or None
        The truth, where it is known.
    images : tuple of two arrays, or None
        Source and target image.

    Examples
    --------
    >>> points = np.random.default_rng(0).uniform(0, 100, (60, 2))
    >>> scene = Recorded("still", "flat", points, points, (), (), None, (100, 100))
    >>> problem = scene.draw(51, seed=0)
    >>> len(problem.source), len(problem.unseen_source)
    (51, 9)
    """

    name: str
    kind: str
    source: Floats
    target: Floats
    source_contour: Rings
    target_contour: Rings
    image_size: tuple[float, float] | None
    target_size: tuple[float, float]
    homography: Floats | None = None
    images: tuple[NDArray[Any], NDArray[Any]] | None = None

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers of matches to try: the paper's, as far as there are so many, else all there are."""
        return tuple(n for n in SIZES if n <= len(self.source)) or (len(self.source),)

    def repeats(self, n: int, wanted: int) -> int:
        """Return how many different draws of n matches to make: one of all."""
        return wanted if n < len(self.source) else 1

    def draw(self, n: int, seed: int) -> Problem:
        """Return a problem with n matches drawn at random; the others are unseen, unless a homography is known."""
        mixed = np.random.default_rng(seed).permutation(len(self.source))
        seen, rest = np.sort(mixed[:n]), np.sort(mixed[n:])
        truth = self.source[rest], self.target[rest]
        if self.homography is not None:
            inside = lattice(covered_region(self.source, "source"), _TRUTH)
            truth = inside, _mapped(self.homography, inside)
        contours = self.source_contour, self.target_contour
        data = self.source[seen], self.target[seen]
        return Problem(*data, *truth, *contours, self.image_size, self.target_size)


Scene: TypeAlias = Simulated | Recorded
"""What problems are drawn from."""


def digest(scenes: Sequence[Recorded]) -> str:
    """Return a fingerprint of everything in scenes that changes the trials: not of images and kinds.

    Parameters
    ----------
    scenes : sequence of Recorded
        In order.

    Returns
    -------
    str
        Sixteen hexadecimal digits.

    Examples
    --------
    >>> points = np.random.default_rng(0).uniform(0, 100, (60, 2))
    >>> scenes = [Recorded(name, "", points, points, (), (), None, (100, 100)) for name in ("one", "two")]
    >>> digest(scenes) == digest(scenes[:1])
    False
    """
    parts = []
    for scene in scenes:
        arrays = [scene.source, scene.target, *scene.source_contour, *scene.target_contour]
        arrays += [] if scene.homography is None else [scene.homography]
        rings = len(scene.source_contour), len(scene.target_contour)
        identity = (scene.name, scene.image_size, scene.target_size, rings, [array.shape for array in arrays])
        parts += [repr(identity).encode(), *(array.astype("<f8").tobytes() for array in arrays)]
    return hashlib.sha256(b"".join(parts)).hexdigest()[:16]


def read_scenes(folder: Path) -> list[Recorded]:
    """Read all scenes of a directory, whose files this module describes.

    Parameters
    ----------
    folder : path
        The directory.

    Returns
    -------
    list of Recorded
        In the order of their names; one at least.

    Raises
    ------
    ValueError
        If there is none, or if a file does not hold what it should.
    OSError
        If a file cannot be read.
    ImportError
        If there are masks, and scikit-image is not installed, or images, and Pillow is not.

    Examples
    --------
    >>> import tempfile
    >>> from mexpress.io.matches import write_matches
    >>> points = np.random.default_rng(0).uniform(0, 100, (60, 2))
    >>> with tempfile.TemporaryDirectory() as name:
    ...     write_matches(f"{name}/still.csv", points, points)
    ...     [scene.name for scene in read_scenes(Path(name))]
    ['still']
    """
    if not folder.is_dir():
        check.refuse("data", "It must be a directory of scenes.", str(folder))
    declared = _declared(folder / "scenes.json")
    tables = sorted(path for path in folder.iterdir() if path.suffix.lower() in _TABLES)
    matches = [
        path for path in tables if path.stem in declared or not (declared or path.stem.endswith(_PARTS))
    ]
    if not matches and not declared:
        rule = "The directory must hold files of matches, such as NAME.csv."
        check.refuse("data", rule, f"{folder}, which has none")
    names = [path.stem for path in matches]
    strange = sorted((set(declared) - set(names)) | {name for name in names if names.count(name) > 1})
    if strange:
        rule = "Every scene must have one file of matches."
        check.refuse("data", rule, f"{', '.join(strange)} in {folder}")
    return [_read(path, declared.get(path.stem, {})) for path in matches]


def _declared(path: Path) -> dict[str, Mapping[str, Any]]:
    """Return what scenes.json tells of the scenes."""
    if not path.exists():
        return {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        check.refuse("data", "scenes.json must be JSON.", f"{path}: {error}")
    known = {"kind", "image_size", "target_size", "homography"}
    shaped = isinstance(content, dict) and all(isinstance(entry, dict) for entry in content.values())
    if not shaped or any(set(entry) - known for entry in content.values()):
        rule = f"scenes.json must hold an object for each scene, with any of {', '.join(sorted(known))}."
        check.refuse("data", rule, str(path))
    return dict(content)


def _read(path: Path, declaration: Mapping[str, Any]) -> Recorded:
    name, kind = path.stem, declaration.get("kind", "")
    if kind not in ("", *KINDS):
        check.refuse("kind", f"It must be one of {', '.join(KINDS)}.", f"{kind!r} for {name}")
    source, target = read_matches(path)
    if len(source) < _FEWEST:
        check.refuse("data", f"A scene must have {_FEWEST} matches at least.", f"{len(source)} in {path}")
    masks = [_mask(path, side) for side in ("source", "target")]
    images = [_image(path, f"_{side}") for side in ("source", "target")]
    first, second = (
        _contour(path, side, mask) for side, mask in zip(("source", "target"), masks, strict=True)
    )
    with _named(f"the scene {name}"):
        homography = _homography(declaration.get("homography"), [source, *first])
        if first and not second and homography is not None:
            second = tuple(_mapped(homography, ring) for ring in first)
        if bool(first) != bool(second):
            check.refuse("data", "A contour must be given in both images.", "one of them")
        size, target_size = (
            _size(key, declaration.get(key), mask, image)
            for key, mask, image in zip(("image_size", "target_size"), masks, images, strict=True)
        )
        if target_size is None and second:
            rule = "The size of the target image must be known where a contour is: in scenes.json, or by an image."
            check.refuse("target_size", rule, "none")
        _check_inside("image_size", size, source, first)
        _check_inside("target_size", target_size, target, second)
    pair = (images[0], images[1]) if images[0] is not None and images[1] is not None else None
    shown = target_size or _extent(target)
    return Recorded(name, kind, source, target, first, second, size, shown, homography, pair)


@contextmanager
def _named(what: str) -> Iterator[None]:
    """Let messages say in what file or scene something is wrong."""
    try:
        yield
    except (ValueError, TypeError) as error:
        kind = TypeError if isinstance(error, TypeError) else ValueError
        raise kind(f"{str(error).removesuffix('.')}, in {what}.") from error


def _beside(path: Path, part: str, endings: tuple[str, ...]) -> Path | None:
    """Return the file beside a scene's matches that holds a part of it."""
    candidates = (path.with_name(path.stem + part + ending) for ending in endings)
    return next((other for other in candidates if other.exists()), None)


def _image(path: Path, part: str) -> NDArray[Any] | None:
    file = _beside(path, part, _IMAGES)
    return None if file is None else read_image(file)


def _mask(path: Path, side: str) -> NDArray[np.bool_] | None:
    image = _image(path, f"_{side}_mask")
    if image is None:
        return None
    if image.ndim == 3:
        image = image[..., : 3 if image.shape[2] > 2 else 1].max(axis=2)  # not what is opaque
    return np.asarray(image != 0, dtype=np.bool_)


def _contour(path: Path, side: str, mask: NDArray[np.bool_] | None) -> Rings:
    """Return the rings of a contour or of a mask; none if there is neither."""
    file = _beside(path, f"_{side}_contour", _TEXTS)
    if file is not None:
        with _named(str(file)):
            return (resampled(read_points(file), _STEP),)
    rings = () if mask is None else outlines(mask)
    if mask is not None and not rings:
        check.refuse("mask", "It must be nonzero somewhere.", f"the {side} mask of {path.stem}")
    return rings


def _homography(value: Any, mapped: Sequence[Floats]) -> Floats | None:
    """Return a homography that puts none of the points, nor what is between them, at infinity."""
    if value is None:
        return None
    matrix = check.matrix(value, "homography")
    if matrix.shape != (3, 3) or np.linalg.matrix_rank(matrix) < 3:
        check.refuse("homography", "It must be an invertible (3, 3) matrix.", str(value))
    denominators = np.concatenate(mapped) @ matrix[2, :2] + matrix[2, 2]
    if not (denominators > 0).all() and not (denominators < 0).all():
        rule = "Its denominator must have the same sign at all matches and all over the contour."
        check.refuse("homography", rule, f"{denominators.min():.3g} to {denominators.max():.3g}")
    return matrix


def _size(
    name: str, declaration: Any, mask: NDArray[np.bool_] | None, image: NDArray[Any] | None
) -> tuple[float, float] | None:
    """Return an image's size, which all that tells it must tell alike."""
    known = [(float(shown.shape[1]), float(shown.shape[0])) for shown in (mask, image) if shown is not None]
    declared = check.image_size(declaration)
    if declared is not None:
        known.append(declared)
    if len(set(known)) > 1:
        sizes = " and ".join(f"{width:g} x {height:g}" for width, height in known)
        check.refuse(name, "Mask, image and scenes.json must have the same size.", sizes)
    return known[0] if known else None


def _check_inside(name: str, size: tuple[float, float] | None, matches: Floats, rings: Rings) -> None:
    """Refuse a size that is not that of the matches' image, and a contour without a pixel in the image."""
    width, height = size or _extent(np.vstack([matches, *rings]))
    inside = float(((matches > -1) & (matches < (width + 1, height + 1))).all(axis=1).mean())
    if size is not None and inside < _INSIDE:
        rule = "Most matches must lie in the image."
        check.refuse(name, rule, f"{width:g} x {height:g}, with {inside:.0%} of the matches inside")
    if rings and width * height > _LARGEST:
        rule = f"An image that has a contour must have {_LARGEST:,} pixels at most."
        check.refuse(name, rule, f"{width:g} x {height:g}")
    if rings and not rasterised(rings, (width, height)).any():
        check.refuse(
            "contour", f"It must cover a pixel of the image, {width:g} x {height:g}.", "one that does not"
        )


def _extent(points: Floats) -> tuple[float, float]:
    """Size of an image that ends with the points; of one pixel at least."""
    right, bottom = np.maximum(points.max(axis=0), 0) + 1
    return float(right), float(bottom)


def _mapped(homography: Floats, points: Floats) -> Floats:
    lifted = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return np.asarray(lifted[:, :2] / lifted[:, 2:])
