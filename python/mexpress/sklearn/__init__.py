"""Estimators of scikit-learn (extra ``sklearn``) that cross-validate themselves in closed form, and surfaces as one.

`LinearRegression` and `Ridge` are scikit-learn's, with `cross_val_predict` and `cross_val_score` that need no refits,
for any splitter. `RidgeCV` scores all weights with any splitter from one decomposition. `SurfaceRegressor` selects a
surface when it is fitted. Every scheme of `mexpress.schemes` is a splitter: ``cross_val_score(any_estimator, X, y,
cv=scheme)``.

Examples
--------
>>> import numpy as np
>>> from sklearn.model_selection import KFold
>>> from mexpress.sklearn import Ridge
>>> rng = np.random.default_rng(0)
>>> X = rng.normal(size=(60, 5))
>>> y = X @ [1.0, 2.0, 3.0, 4.0, 5.0] + rng.normal(size=60)
>>> Ridge(alpha=1.0).cross_val_score(X, y, cv=KFold(3)).round(3)
array([0.987, 0.987, 0.986])
"""

try:
    import sklearn as _installed
except ImportError as error:
    message = "mexpress.sklearn needs scikit-learn: pip install 'mexpress[sklearn]'"
    raise ImportError(message) from error

from mexpress.sklearn.linear import LinearRegression, Ridge
from mexpress.sklearn.ridge_cv import RidgeCV
from mexpress.sklearn.surface import SurfaceRegressor

__all__ = ["LinearRegression", "Ridge", "RidgeCV", "SurfaceRegressor"]

del _installed


def __dir__() -> list[str]:
    return __all__
