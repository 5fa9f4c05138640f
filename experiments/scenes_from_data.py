"""Make scenes for ``mexpress reproduce table2 SCENES`` of image pairs with a known homography, and of tracked points.

Usage: ``python experiments/scenes_from_data.py DATA SCENES``; needs OpenCV. DATA is a directory with any of

flat/graf1.png, graf3.png, H1to3p.xml   two images of a plane and the homography between them, as OpenCV ships them
flat/NAMEA.png, NAMEB.png, NAME_matches.npz   two images, tentative matches (n, 4) and the homography H_A_to_B
sheets/NAME.npz   image_points (views, n, 2) and visible (views, n) of a sheet that deforms

Matches of planes are SIFT's, or the tentative ones, that the homography maps to within 3 pixels of each other; their
contour is an ellipse among the matches, which the homography moves. Of a sheet the first view is matched to the middle
one and to the last; no contour is known there.
"""

import argparse
import json
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import cv2
import numpy as np

from mexpress.io.matches import write_matches, write_points_csv

RATIO = 0.8
"""How much nearer than the second nearest descriptor the nearest must be."""

TOLERANCE = 3.0
"""Pixels from a match to where the homography puts it."""


def mapped(homography, points):
    """Apply a homography to points (n, 2)."""
    return cv2.perspectiveTransform(points[None], homography)[0]


def sift_matches(first, second):
    """Return matches (n, 4) of two images that pass the ratio test, each place once."""
    sift = cv2.SIFT_create()
    (points, codes), (others, other_codes) = (sift.detectAndCompute(image, None) for image in (first, second))
    found = [
        (*points[best.queryIdx].pt, *others[best.trainIdx].pt)
        for best, second_best in cv2.BFMatcher().knnMatch(codes, other_codes, k=2)
        if best.distance < RATIO * second_best.distance
    ]
    return np.unique(np.array(found), axis=0)


def ellipse(points):
    """Return a contour, (120, 2), about the middle of points, most of which it encloses."""
    angle = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    centre, half = points.mean(axis=0), 1.4 * points.std(axis=0)
    return centre + half * np.column_stack([np.cos(angle), np.sin(angle)])


def write_plane(out, name, images, matches, homography):
    """Write a flat scene; return what scenes.json has of it."""
    matches = np.asarray(matches, dtype=float)
    source, target = matches[:, :2], matches[:, 2:]
    right = np.hypot(*(mapped(homography, source) - target).T) < TOLERANCE
    write_matches(out / f"{name}.csv", source[right], target[right])
    with (out / f"{name}_source_contour.csv").open("w", encoding="utf-8") as file:
        write_points_csv(file, ellipse(source[right]))
    for image, side in zip(images, ("source", "target"), strict=True):
        shutil.copyfile(image, out / f"{name}_{side}.png")
    print(f"{name}: {right.sum()} matches")
    return {"kind": "flat", "homography": homography.tolist()}


def planes(flat, out):
    """Write every flat scene of a directory; return what scenes.json has of them."""
    told = {}
    graf = [flat / "graf1.png", flat / "graf3.png"]
    if all(path.exists() for path in graf):
        numbers = ET.parse(flat / "H1to3p.xml").find("H13/data").text.split()
        homography = np.array(numbers, dtype=float).reshape(3, 3)
        grays = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in graf]
        told["graf"] = write_plane(out, "graf", graf, sift_matches(*grays), homography)
    for path in sorted(flat.glob("*_matches.npz")):
        name = path.stem.removesuffix("_matches")
        with np.load(path) as arrays:
            tentative, homography = arrays["tentative"], arrays["H_A_to_B"]
        images = [flat / f"{name}{side}.png" for side in "AB"]
        told[name] = write_plane(out, name, images, tentative, homography)
    return told


def sheets(folder, out):
    """Write pairs of views of every sheet that is tracked; return what scenes.json has of them."""
    told = {}
    for path in sorted(folder.glob("*.npz")):
        with np.load(path) as arrays:
            if "image_points" not in arrays:
                continue
            points, visible = arrays["image_points"], arrays["visible"].astype(bool)
        for view in (len(points) // 2, len(points) - 1):
            both = visible[0] & visible[view]
            name = f"{path.stem}-{view}"
            write_matches(out / f"{name}.csv", points[0][both], points[view][both])
            told[name] = {"kind": "deformable"}
            print(f"{name}: {both.sum()} matches")
    return told


def write_scenes(data, out):
    """Write every scene that the data hold, and scenes.json."""
    out.mkdir(parents=True, exist_ok=True)
    told = planes(data / "flat", out) | sheets(data / "sheets", out)
    (out / "scenes.json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", metavar="DATA", type=Path)
    parser.add_argument("scenes", metavar="SCENES", type=Path, help="made if it does not exist")
    options = parser.parse_args()
    write_scenes(options.data, options.scenes)
