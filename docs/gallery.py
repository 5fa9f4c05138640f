"""Draw the figures of docs/gallery/ anew (`make gallery`), from the data that mexpress simulates."""

from pathlib import Path

import mexpress as mx

GALLERY = Path(__file__).parent / "gallery"


def draw_warps(folder):
    """Draw what can be seen of a warp: of the best prediction, and of the method of the paper."""
    bent = mx.datasets.bent_page()
    data = {"source": bent.source, "target": bent.target, "image_size": bent.image_size}
    sel = mx.select_warp(**data)
    sel.plot(folder / "curves.png")
    sel.plot_radii(folder / "radii.png")
    sel.plot_warp(folder / "warp.jpg")
    sel.plot_error(folder / "error.jpg")
    sel.plot_registration(bent.page, bent.photo, folder / "registered.jpg")
    paper = mx.select_warp(
        **data, criteria=["FIT", "CMPRESS", "ER5", "ER10", "ER20", "AIC", "BIC"], smoothing=0
    )
    paper.plot(folder / "counts.png")


def draw_surfaces(folder):
    """Draw what can be seen of a surface."""
    land = mx.datasets.terrain(noise=2.0)
    sel = mx.select_surface(land.points, land.values)
    sel.plot_surface(folder / "surface.jpg")
    sel.plot_residuals(folder / "residuals.jpg")
    paper = mx.select_surface(land.points, land.values, "ER1", smoothing=0, max_count=150)
    paper.plot_control_points(folder / "control-points.jpg")


if __name__ == "__main__":
    GALLERY.mkdir(exist_ok=True)
    draw_warps(GALLERY)
    draw_surfaces(GALLERY)
