//! Which data are near which.

use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::arrays::{Array1, Arrays, arrays, indices, matrix, slice};
use super::interrupt::interruptible;
use crate::near::{delaunay, distance_matching, hilbert, neighbours};

/// Neighbourhoods that are found when they are needed.
#[pyclass(frozen, module = "mexpress._core")]
pub(super) struct LazyNeighbourhoods(pub(super) neighbours::LazyNeighbourhoods);

#[pymethods]
impl LazyNeighbourhoods {
    /// Within a radius of all points, or of some of them alone.
    #[staticmethod]
    #[pyo3(signature = (points, radius, threads, centres = None))]
    fn within(
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f64>,
        radius: f64,
        threads: usize,
        centres: Option<PyReadonlyArray1<'_, usize>>,
    ) -> PyResult<Self> {
        let (dimension, points) = (points.shape()[1], matrix(&points)?);
        let centres = centres.as_ref().map(slice).transpose()?;
        let found = interruptible(py, all_from_each(points, dimension), threads, |pool| {
            let all = neighbours::LazyNeighbourhoods::within(points, dimension, radius, pool)?;
            match centres {
                Some(centres) => all.around(centres),
                None => Ok(all),
            }
        })?;
        Ok(Self(found))
    }

    #[staticmethod]
    fn nearest(
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f64>,
        k: usize,
        threads: usize,
    ) -> PyResult<Self> {
        let (dimension, points) = (points.shape()[1], matrix(&points)?);
        let found = interruptible(py, all_from_each(points, dimension), threads, |pool| {
            neighbours::LazyNeighbourhoods::nearest(points, dimension, k, pool)
        })?;
        Ok(Self(found))
    }

    /// The neighbourhoods of some of the points, as (offsets, items).
    fn listed<'py>(
        &self,
        py: Python<'py>,
        centres: PyReadonlyArray1<'py, usize>,
        threads: usize,
    ) -> PyResult<Arrays<'py>> {
        let centres = slice(&centres)?;
        let found = interruptible(py, f64::INFINITY, threads, |pool| self.0.list(centres, pool))?;
        Ok(arrays(py, found))
    }

    #[getter]
    fn mean(&self) -> f64 {
        self.0.mean
    }
}

/// What looking at a coordinate of a point from another one takes, in multiply-adds, with all that follows from it.
const LOOK: f64 = 20.0;

/// Looking at all points from each, which is the worst that a search comes to.
fn all_from_each(points: &[f64], dimension: usize) -> f64 {
    LOOK * points.len() as f64 * points.len() as f64 / dimension.max(1) as f64
}

/// What sorting takes for a coordinate, in multiply-adds.
const HILBERT: f64 = 1e3;

/// The points in the order of a curve that fills the space.
#[pyfunction]
pub(super) fn hilbert_order<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    threads: usize,
) -> PyResult<Array1<'py, i64>> {
    let dimension = points.shape()[1];
    let points = matrix(&points)?;
    let order = interruptible(py, HILBERT * points.len() as f64, threads, |pool| {
        hilbert::hilbert_order(points, dimension, pool)
    })?;
    Ok(indices(py, order))
}

/// Neighbourhoods of points within a radius, as (offsets, items).
#[pyfunction]
pub(super) fn neighbours_within<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    radius: f64,
    threads: usize,
) -> PyResult<Arrays<'py>> {
    let dimension = points.shape()[1];
    let points = matrix(&points)?;
    let found = interruptible(py, all_from_each(points, dimension), threads, |pool| {
        neighbours::within(points, dimension, radius, pool)
    })?;
    Ok(arrays(py, found))
}

/// The k nearest of each point, itself counted, as (offsets, items).
#[pyfunction]
pub(super) fn neighbours_nearest<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    k: usize,
    threads: usize,
) -> PyResult<Arrays<'py>> {
    let dimension = points.shape()[1];
    let points = matrix(&points)?;
    let found = interruptible(py, all_from_each(points, dimension), threads, |pool| {
        neighbours::nearest(points, dimension, k, pool)
    })?;
    Ok(arrays(py, found))
}

/// Neighbourhoods that leave every point as far from its nearest as queries are from theirs, as (offsets, items).
#[pyfunction]
pub(super) fn neighbours_matched<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    queries: PyReadonlyArray2<'py, f64>,
    most: usize,
    threads: usize,
) -> PyResult<Arrays<'py>> {
    let dimension = points.shape()[1];
    let (points, queries) = (matrix(&points)?, matrix(&queries)?);
    let found = interruptible(py, f64::INFINITY, threads, |pool| {
        distance_matching::matched(points, queries, dimension, most, pool)
    })?;
    Ok(arrays(py, found))
}

/// Each point with its neighbours in the Delaunay triangulation, as (offsets, items).
#[pyfunction]
pub(super) fn neighbours_delaunay<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
) -> PyResult<Arrays<'py>> {
    let points = matrix(&points)?;
    let found = interruptible(py, all_from_each(points, 2), 1, |pool| delaunay::delaunay(points, pool))?;
    Ok(arrays(py, found))
}
