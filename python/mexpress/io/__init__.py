"""Data in files as people have them: text, numpy's archives, images, point clouds and meshes.

Examples
--------
>>> import tempfile
>>> from mexpress.io.matches import read_matches
>>> with tempfile.TemporaryDirectory() as folder:
...     with open(f"{folder}/matches.csv", "w") as file:
...         print("1,2,3,4", file=file)
...     read_matches(f"{folder}/matches.csv")
(array([[1., 2.]]), array([[3., 4.]]))
"""
