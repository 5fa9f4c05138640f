//! Models at many points.

use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::arrays::{Array2, matrix, table};
use super::interrupt::interruptible;
use crate::error::Error;
use crate::evaluate::spline::Splines;
use crate::pool::Pool;

/// Thin-plate splines at points: a row each.
#[pyfunction]
pub(super) fn spline_values<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    centres: PyReadonlyArray2<'py, f64>,
    weights: PyReadonlyArray2<'py, f64>,
    threads: usize,
) -> PyResult<Array2<'py, f64>> {
    rows(py, &points, &centres, &weights, 1, threads, |splines, points, pool| splines.values(points, pool))
}

/// Their derivatives along x and y: a row of pairs each.
#[pyfunction]
pub(super) fn spline_slopes<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    centres: PyReadonlyArray2<'py, f64>,
    weights: PyReadonlyArray2<'py, f64>,
    threads: usize,
) -> PyResult<Array2<'py, f64>> {
    rows(py, &points, &centres, &weights, 2, threads, |splines, points, pool| splines.slopes(points, pool))
}

fn rows<'py>(
    py: Python<'py>,
    points: &PyReadonlyArray2<'py, f64>,
    centres: &PyReadonlyArray2<'py, f64>,
    weights: &PyReadonlyArray2<'py, f64>,
    numbers: usize,
    threads: usize,
    evaluate: impl for<'a> Fn(&Splines<'a>, &[f64], &Pool<'_>) -> Result<Vec<f64>, Error> + Send + Sync,
) -> PyResult<Array2<'py, f64>> {
    let (n, columns) = (points.shape()[0], weights.shape()[1]);
    // A logarithm is worth about ten multiply-adds.
    let cost = (n * weights.shape()[0] * (10 + numbers * columns)) as f64;
    let (points, centres, weights) = (matrix(points)?, matrix(centres)?, matrix(weights)?);
    let splines = Splines { centres, weights, columns };
    let values = interruptible(py, cost, threads, |pool| evaluate(&splines, points, pool))?;
    table(py, values, n, numbers * columns)
}
