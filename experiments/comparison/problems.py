"""The rows that methods are compared on: by name a function each, from the number of a draw to a `Problem`.

Draw k of a row depends on k alone. A row whose data are not in the data directory is left out.
"""

from functools import partial

from comparison import gaps, heights, matches

SHEETS = {"hulk": None, "kinectpaper": matches.SIZE}
"""Tracked sheets, and the size of their images if it is known."""

DEPTHS = {"TUM": ("TUM_depth.png", 5000.0), "PrimeSense": ("depth_00000.png", 1000.0)}
"""Files of depth maps, and their units per metre."""

BENT_NOISE = 0.1
"""Noise of the sheet in space, which is 25 wide."""


def warps(data):
    """Return the rows of matches as dense as what judges."""
    rows = {f"homography ({n})": partial(matches.homography, n) for n in (30, 100, 300)}
    for name, size in SHEETS.items():
        path = data / "sheets" / f"{name}.npz"
        if path.exists():
            rows[f"{name} as measured"] = partial(matches.tracked, path, 0.0, size)
            rows[f"{name} + 2 px"] = partial(matches.tracked, path, 2.0, size)
    rows |= {f"simulated sheets ({n})": partial(matches.sheet, n) for n in (50, 150)}
    graf, boat = data / "flat" / "H1to3p.xml", data / "flat" / "boat_matches.npz"
    if graf.exists():
        rows["graf 1 to 3 (100)"] = partial(matches.graf, graf, 100)
    if boat.exists():
        rows["boat"] = partial(matches.inliers, boat)
    scenes = {"homography": matches.homography, "simulated sheets": matches.sheet}
    for name, scene in scenes.items():
        rows[f"{name} (100), clustered"] = partial(matches.clustered, scene, 100)
    for name, scene in scenes.items():
        rows[f"{name} (100), shared noise"] = partial(matches.shaken, scene, 100)
    return rows


def few(data):
    """Return the rows of 12 to 30 matches."""
    rows = {
        f"old map, {kind} ({n})": partial(matches.old_map, kind, n)
        for kind in ("affine", "perspective", "bent")
        for n in (12, 20, 30)
    }
    rows |= {f"homography ({n})": partial(matches.homography, n) for n in (12, 20)}
    adam = data / "flat" / "adam_matches.npz"
    return rows | ({"adam": partial(matches.inliers, adam)} if adam.exists() else {})


def maps(data):
    """Return by name what reads a map."""
    files = {name: (data / "depth" / file, scale) for name, (file, scale) in DEPTHS.items()}
    read = {name: partial(heights.depth_map, *given) for name, given in files.items() if given[0].exists()}
    return read | {"Jacksboro": heights.terrain, "motorcycle": heights.disparities}


def surfaces(data):
    """Return the rows of surfaces."""
    rows = {
        f"{name} ({n})": partial(heights.pixels, read, n)
        for name, read in maps(data).items()
        for n in (300, 1000)
    }
    rows["Jacksboro, tracks"] = partial(heights.tracks, heights.terrain, 400)
    kinds = {"independent": "noise", "correlated": "shared noise", "clustered": "clustered"}
    rows |= {f"random field, {text}": partial(heights.field, kind) for kind, text in kinds.items()}
    bent = data / "sheets" / "bent_paper_239.npz"
    if bent.exists():
        rows["sheet in space"] = partial(heights.sheet_in_space, bent, 0.0)
        rows["sheet in space + noise"] = partial(heights.sheet_in_space, bent, BENT_NOISE)
    return rows


def cut(scenes):
    """Return the rows with discs cut out, and those with a side cut off."""
    return {
        f"{name}: {kind}": partial(gaps.with_gaps, scene, how)
        for kind, how in (("discs", gaps.discs), ("side", gaps.side))
        for name, scene in scenes.items()
    }


def warps_with_gaps(data):
    """Return the rows of matches that are judged in gaps."""
    scenes = {
        "homography (100)": partial(matches.homography, 100),
        "simulated sheets (100)": partial(matches.sheet, 100),
        "old map, bent (40)": partial(matches.old_map, "bent", 40),
    }
    for name, size in SHEETS.items():
        path = data / "sheets" / f"{name}.npz"
        if path.exists():
            scenes[name] = partial(matches.all_tracked, path, size)
    return cut(scenes)


def surfaces_with_gaps(data):
    """Return the rows of surfaces that are judged in gaps."""
    scenes = {f"{name} (300)": partial(heights.pixels, read, 300) for name, read in maps(data).items()}
    for kind, text in (("independent", "noise"), ("correlated", "shared noise")):
        scenes[f"random field, {text} (300)"] = partial(heights.field, kind, most=300)
    bent = data / "sheets" / "bent_paper_239.npz"
    if bent.exists():
        scenes["sheet in space"] = partial(heights.whole_sheet_in_space, bent, BENT_NOISE)
    return cut(scenes)


FEW = "Warps of 12 to 30 matches"
GAPS = ("Warps, judged in gaps", "Surfaces, judged in gaps")
TABLES = {
    "Warps": warps,
    FEW: few,
    "Surfaces": surfaces,
    GAPS[0]: warps_with_gaps,
    GAPS[1]: surfaces_with_gaps,
}
"""Rows by the title of their table."""


def drawn(data, row, draw):
    """Return a draw of a row."""
    return {name: scene for rows in TABLES.values() for name, scene in rows(data).items()}[row](draw)
