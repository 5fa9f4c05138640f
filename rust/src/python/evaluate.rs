//! Models at many points.

use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{Array1, Array2, indices, matrix, slice, table};
use super::interrupt::interruptible;
use crate::error::Error;
use crate::evaluate::bspline::{Axis, BSplines};
use crate::evaluate::hats::Hats;
use crate::evaluate::local::Local;
use crate::evaluate::preimages;
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

/// Functions of which few are nonzero at a point.
#[pyclass(frozen, module = "mexpress._core")]
pub(super) struct LocalFunctions(Kind);

enum Kind {
    BSplines(BSplines),
    Hats(Box<Hats>),
}

impl LocalFunctions {
    /// Multiply-adds that so many numbers for each function are worth at a point.
    fn cost(&self, numbers: usize) -> usize {
        match &self.0 {
            Kind::BSplines(functions) => functions.search() + BSplines::MOST * numbers,
            Kind::Hats(functions) => functions.search() + Hats::MOST * numbers,
        }
    }
}

#[pymethods]
impl LocalFunctions {
    /// B-splines over a grid: the first coordinate and the step of its lines, and the control points at their crossings.
    #[staticmethod]
    fn bsplines(
        x: (f64, f64, usize),
        y: (f64, f64, usize),
        order: PyReadonlyArray1<'_, usize>,
    ) -> PyResult<Self> {
        let axes = [x, y].map(|(low, step, number)| Axis { low, step, number });
        BSplines::new(axes, slice(&order)?.to_vec())
            .map(|functions| Self(Kind::BSplines(functions)))
            .ok_or_else(|| PyValueError::new_err("no grid"))
    }

    /// Hat functions of a triangulation: its points, corners, their gradients, and triangles and sides of its hull.
    #[staticmethod]
    fn hats(
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f64>,
        corners: PyReadonlyArray1<'_, usize>,
        gradients: PyReadonlyArray2<'_, f64>,
        triangles: PyReadonlyArray1<'_, usize>,
        sides: PyReadonlyArray1<'_, usize>,
    ) -> PyResult<Self> {
        let hull: Vec<_> =
            std::iter::zip(slice(&triangles)?, slice(&sides)?).map(|(&t, &side)| (t, side)).collect();
        let (points, corners, gradients) = (matrix(&points)?, slice(&corners)?, matrix(&gradients)?);
        let hats = py.detach(|| Hats::new(points, corners, gradients, &hull))?;
        Ok(Self(Kind::Hats(Box::new(hats))))
    }

    /// Their combinations at points: a row each.
    fn values<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'py, f64>,
        parameters: PyReadonlyArray2<'py, f64>,
        threads: usize,
    ) -> PyResult<Array2<'py, f64>> {
        let (n, columns) = (points.shape()[0], parameters.shape()[1]);
        let (points, parameters) = (matrix(&points)?, matrix(&parameters)?);
        let cost = (n * self.cost(columns)) as f64;
        let values = interruptible(py, cost, threads, |pool| match &self.0 {
            Kind::BSplines(functions) => functions.values(points, parameters, columns, pool),
            Kind::Hats(functions) => functions.values(points, parameters, columns, pool),
        })?;
        table(py, values, n, columns)
    }

    /// The derivatives of these along x and y: a row of pairs each.
    fn slopes<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'py, f64>,
        parameters: PyReadonlyArray2<'py, f64>,
        threads: usize,
    ) -> PyResult<Array2<'py, f64>> {
        let (n, columns) = (points.shape()[0], parameters.shape()[1]);
        let (points, parameters) = (matrix(&points)?, matrix(&parameters)?);
        let cost = (n * self.cost(2 * columns)) as f64;
        let slopes = interruptible(py, cost, threads, |pool| match &self.0 {
            Kind::BSplines(functions) => functions.slopes(points, parameters, columns, pool),
            Kind::Hats(functions) => functions.slopes(points, parameters, columns, pool),
        })?;
        table(py, slopes, n, 2 * columns)
    }

    /// Indices and elements of the nonzero functions (0), or of their derivatives along x (1) or y (2), at points: a row each.
    fn elements<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'py, f64>,
        order: usize,
    ) -> PyResult<(Array1<'py, i64>, Array2<'py, f64>)> {
        if order > 2 {
            return Err(PyValueError::new_err("no such derivative"));
        }
        let (n, points) = (points.shape()[0], matrix(&points)?);
        let ((functions, elements), most) = py.detach(|| match &self.0 {
            Kind::BSplines(functions) => (functions.elements(points, order), BSplines::MOST),
            Kind::Hats(functions) => (functions.elements(points, order), Hats::MOST),
        });
        Ok((indices(py, functions), table(py, elements, n, most)?))
    }
}

/// What a map of triangles maps to positions: a row each, NaN where there is none or more than one.
///
/// Rows of `corners` have a place, both numerators and the denominator, three rows a triangle.
#[pyfunction]
#[pyo3(name = "preimages")]
pub(super) fn preimages_of<'py>(
    py: Python<'py>,
    positions: PyReadonlyArray2<'py, f64>,
    corners: PyReadonlyArray2<'py, f64>,
    least: f64,
    threads: usize,
) -> PyResult<Array2<'py, f64>> {
    let n = positions.shape()[0];
    let (positions, triangles) = (matrix(&positions)?, matrix(&corners)?.as_chunks().0.as_chunks().0);
    // A cell has some triangles in the mean, and a triangle some cells.
    let cost = (100 * n + 1000 * triangles.len()) as f64;
    let found =
        interruptible(py, cost, threads, |pool| preimages::preimages(positions, triangles, least, pool))?;
    table(py, found, n, 2)
}
