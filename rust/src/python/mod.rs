//! The boundary to Python. The only folder that names PyO3: arrays in, arrays out, the interpreter released in between.
//!
//! Checks that deserve a sentence are made in Python; what is checked here keeps memory safe, no more.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

use crate::error::Error;
use crate::fit::factor::Problem;
use crate::holdout::nested;
use crate::holdout::pairs::{Pairs, Status};
use crate::near::{delaunay, distance_matching, hilbert, neighbours};
use crate::place::{by_residual, lloyd};
use crate::pool::Pool;
use crate::sets::Sets;

type Array1<'py, T> = Bound<'py, PyArray1<T>>;
type Array2<'py, T> = Bound<'py, PyArray2<T>>;
type Arrays<'py> = (Array1<'py, i64>, Array1<'py, i64>);

impl From<Error> for PyErr {
    fn from(error: Error) -> Self {
        match error {
            // The arguments are good; the arrays kept from before are not.
            Error::Changed { .. } => PyRuntimeError::new_err(error.to_string()),
            _ => PyValueError::new_err(error.to_string()),
        }
    }
}

/// Multiply-adds that pass before anybody presses Ctrl-C: shorter work is done at once, on this thread.
const SHORT: f64 = 2e8;

/// Does the work with the interpreter released. Signals reach the main thread alone, so long work goes to another one
/// while this one looks for them.
fn interruptible<T: Send>(
    py: Python<'_>,
    cost: f64,
    threads: usize,
    work: impl FnOnce(&Pool<'_>) -> Result<T, Error> + Send,
) -> PyResult<T> {
    let cancel = AtomicBool::new(false);
    let pool = Pool::new(threads, &cancel);
    if cost < SHORT {
        return Ok(py.detach(|| work(&pool))?);
    }
    let mut signal = Ok(());
    let watch = |signal: &mut PyResult<()>| {
        let (done, finished) = channel::<()>();
        std::thread::scope(|scope| {
            let worker = scope.spawn(|| {
                // Dropped when the work ends, however it ends.
                let _done = done;
                work(&pool)
            });
            while finished.recv_timeout(Duration::from_millis(50)) == Err(RecvTimeoutError::Timeout) {
                if signal.is_ok() {
                    *signal = Python::attach(|py| py.check_signals());
                    cancel.store(signal.is_err(), Ordering::Relaxed);
                }
            }
            worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })
    };
    let result = py.detach(|| watch(&mut signal));
    signal?;
    Ok(result?)
}

fn slice<'a, T: numpy::Element>(array: &'a PyReadonlyArray1<'_, T>) -> PyResult<&'a [T]> {
    array.as_slice().map_err(|_| PyValueError::new_err("array is not contiguous"))
}

fn matrix<'a, T: numpy::Element>(array: &'a PyReadonlyArray2<'_, T>) -> PyResult<&'a [T]> {
    if array.is_c_contiguous() { array.as_slice().ok() } else { None }
        .ok_or_else(|| PyValueError::new_err("array is not contiguous"))
}

fn numbers(values: &PyReadonlyArray1<'_, i64>) -> PyResult<Vec<usize>> {
    let index = |&i: &i64| usize::try_from(i).map_err(|_| PyValueError::new_err("negative index"));
    slice(values)?.iter().map(index).collect()
}

fn sets(offsets: &PyReadonlyArray1<'_, i64>, items: &PyReadonlyArray1<'_, i64>) -> PyResult<Sets> {
    let (offsets, items) = (numbers(offsets)?, numbers(items)?);
    let whole = offsets.first() == Some(&0) && offsets.last() == Some(&items.len());
    if whole && offsets.is_sorted() {
        Ok(Sets { offsets, items })
    } else {
        Err(PyValueError::new_err("offsets do not cut the items into sets"))
    }
}

fn indices<'py>(py: Python<'py>, values: &[usize]) -> Array1<'py, i64> {
    PyArray1::from_iter(py, values.iter().map(|&i| i as i64))
}

fn arrays<'py>(py: Python<'py>, sets: &Sets) -> Arrays<'py> {
    (indices(py, &sets.offsets), indices(py, &sets.items))
}

fn table<'py>(py: Python<'py>, values: Vec<f64>, rows: usize, columns: usize) -> PyResult<Array2<'py, f64>> {
    PyArray1::from_vec(py, values).reshape([rows, columns])
}

/// The caller's arrays of a problem, kept, not copied: pairs close to rank loss go back to them.
struct Kept {
    design: Py<PyArray2<f64>>,
    responses: Py<PyArray2<f64>>,
    root_weights: Option<Py<PyArray1<f64>>>,
    penalty: Py<PyArray2<f64>>,
}

impl Kept {
    fn borrow<'py>(&self, py: Python<'py>) -> PyResult<Held<'py>> {
        let weights = self.root_weights.as_ref().map(|w| w.bind(py));
        Held::new(self.design.bind(py), self.responses.bind(py), weights, self.penalty.bind(py))
    }
}

/// A fitted least-squares problem.
#[pyclass(frozen, module = "mexpress._core")]
struct Factor {
    fit: crate::fit::factor::Factor,
    arrays: Kept,
}

/// The arrays of a problem, borrowed for one call.
struct Held<'py> {
    design: PyReadonlyArray2<'py, f64>,
    responses: PyReadonlyArray2<'py, f64>,
    root_weights: Option<PyReadonlyArray1<'py, f64>>,
    penalty: PyReadonlyArray2<'py, f64>,
}

impl<'py> Held<'py> {
    fn new(
        design: &Array2<'py, f64>,
        responses: &Array2<'py, f64>,
        root_weights: Option<&Array1<'py, f64>>,
        penalty: &Array2<'py, f64>,
    ) -> PyResult<Self> {
        Ok(Self {
            design: design.try_readonly()?,
            responses: responses.try_readonly()?,
            root_weights: root_weights.map(|w| w.try_readonly()).transpose()?,
            penalty: penalty.try_readonly()?,
        })
    }

    fn problem(&self) -> PyResult<Problem<'_>> {
        Ok(Problem {
            design: matrix(&self.design)?,
            responses: matrix(&self.responses)?,
            root_weights: self.root_weights.as_ref().map(slice).transpose()?,
            penalty: matrix(&self.penalty)?,
            rows: self.design.shape()[0],
            columns: self.design.shape()[1],
        })
    }
}

impl Factor {
    fn build<'py>(
        py: Python<'py>,
        arrays: Kept,
        threads: usize,
        make: impl Fn(&Problem<'_>, &Pool<'_>) -> Result<crate::fit::factor::Factor, Error> + Send + Sync,
    ) -> PyResult<Self> {
        let held = arrays.borrow(py)?;
        let problem = held.problem()?;
        let size = problem.design.len() + problem.penalty.len();
        let cost = 2.0 * (size * problem.columns) as f64;
        let fit = interruptible(py, cost, threads, |pool| make(&problem, pool))?;
        Ok(Self { fit, arrays })
    }
}

#[pymethods]
impl Factor {
    #[new]
    fn new<'py>(
        py: Python<'py>,
        design: Array2<'py, f64>,
        responses: Array2<'py, f64>,
        root_weights: Option<Array1<'py, f64>>,
        penalty: Array2<'py, f64>,
        threads: usize,
    ) -> PyResult<Self> {
        let arrays = Kept {
            design: design.unbind(),
            responses: responses.unbind(),
            root_weights: root_weights.map(Bound::unbind),
            penalty: penalty.unbind(),
        };
        Self::build(py, arrays, threads, crate::fit::factor::Factor::new)
    }

    /// Of a design and penalty rows that have orthonormal columns together.
    #[staticmethod]
    fn orthonormal<'py>(
        py: Python<'py>,
        design: Array2<'py, f64>,
        responses: Array2<'py, f64>,
        penalty: Array2<'py, f64>,
        threads: usize,
    ) -> PyResult<Self> {
        let (design, responses, penalty) = (design.unbind(), responses.unbind(), penalty.unbind());
        let arrays = Kept { design, responses, root_weights: None, penalty };
        Self::build(py, arrays, threads, crate::fit::factor::Factor::orthonormal)
    }

    #[getter]
    fn rank(&self) -> usize {
        self.fit.rank
    }

    #[getter]
    fn coefficients<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        let transposed = table(py, self.fit.coefficients.clone(), self.fit.responses, self.fit.columns)?;
        transposed.transpose()
    }

    #[getter]
    fn residuals<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        table(py, self.fit.plain_residuals(), self.fit.rows, self.fit.responses)
    }

    #[getter]
    fn leverage<'py>(&self, py: Python<'py>) -> Array1<'py, f64> {
        PyArray1::from_slice(py, &self.fit.leverage)
    }

    /// (residuals, rows, offsets, undefined) of the pairs.
    #[expect(clippy::type_complexity)]
    fn predict<'py>(
        &self,
        py: Python<'py>,
        held: (PyReadonlyArray1<'py, i64>, PyReadonlyArray1<'py, i64>),
        validated: (PyReadonlyArray1<'py, i64>, PyReadonlyArray1<'py, i64>),
        rows: (PyReadonlyArray1<'py, i64>, PyReadonlyArray1<'py, i64>),
        order: PyReadonlyArray1<'py, i64>,
        threads: usize,
    ) -> PyResult<(Array2<'py, f64>, Array1<'py, i64>, Array1<'py, i64>, Array1<'py, i64>)> {
        let (held, validated, rows) =
            (sets(&held.0, &held.1)?, sets(&validated.0, &validated.1)?, sets(&rows.0, &rows.1)?);
        // At worst every pair is refitted.
        let cost = 2.0 * held.len() as f64 * (self.fit.basis.len() * self.fit.rank) as f64;
        let order = numbers(&order)?;
        let pairs = Pairs { held: &held, validated: &validated, rows: &rows, order: &order };
        let arrays = self.arrays.borrow(py)?;
        let problem = arrays.problem()?;
        let found = interruptible(py, cost, threads, |pool| self.fit.predict(&problem, &pairs, pool))?;
        let lost = found.status.iter().enumerate().filter(|(_, s)| **s == Status::Undefined).map(|(i, _)| i);
        let count = found.rows.len();
        Ok((
            table(py, found.residuals, count, self.fit.responses)?,
            indices(py, &found.rows),
            indices(py, &found.offsets),
            indices(py, &lost.collect::<Vec<_>>()),
        ))
    }

    /// The covariances of the prediction residuals of pairs, flattened one after another.
    fn spread<'py>(
        &self,
        py: Python<'py>,
        held: ReadSets<'py>,
        validated: ReadSets<'py>,
        rows: ReadSets<'py>,
        threads: usize,
    ) -> PyResult<Array1<'py, f64>> {
        let (held, validated, rows) =
            (sets(&held.0, &held.1)?, sets(&validated.0, &validated.1)?, sets(&rows.0, &rows.1)?);
        let pairs = Pairs { held: &held, validated: &validated, rows: &rows, order: &[] };
        let blocks = interruptible(py, f64::INFINITY, threads, |pool| self.fit.spread(&pairs, pool))?;
        Ok(PyArray1::from_vec(py, blocks))
    }

    /// The blocks of the hat matrix for sets of rows, flattened one after another.
    fn hat_blocks<'py>(
        &self,
        py: Python<'py>,
        rows: (PyReadonlyArray1<'py, i64>, PyReadonlyArray1<'py, i64>),
        threads: usize,
    ) -> PyResult<Array1<'py, f64>> {
        let rows = sets(&rows.0, &rows.1)?;
        let squares: f64 = (0..rows.len()).map(|s| (rows.get(s).len() as f64).powi(2)).sum();
        let cost = squares * self.fit.rank as f64;
        let blocks = interruptible(py, cost, threads, |pool| self.fit.hat_blocks(&rows, pool))?;
        Ok(PyArray1::from_vec(py, blocks))
    }
}

/// Models of leading columns.
#[pyclass(frozen, module = "mexpress._core")]
struct Nested {
    models: nested::Nested,
    arrays: Kept,
}

type ReadSets<'py> = (PyReadonlyArray1<'py, i64>, PyReadonlyArray1<'py, i64>);

#[pymethods]
impl Nested {
    #[new]
    fn new<'py>(
        py: Python<'py>,
        design: Array2<'py, f64>,
        responses: Array2<'py, f64>,
        root_weights: Option<Array1<'py, f64>>,
        penalty: Array2<'py, f64>,
        threads: usize,
    ) -> PyResult<Self> {
        let arrays = Kept {
            design: design.unbind(),
            responses: responses.unbind(),
            root_weights: root_weights.map(Bound::unbind),
            penalty: penalty.unbind(),
        };
        let held = arrays.borrow(py)?;
        let problem = held.problem()?;
        let models = interruptible(py, f64::INFINITY, threads, |pool| nested::Nested::new(&problem, pool))?;
        Ok(Self { models, arrays })
    }

    /// The coefficients of the model of the first columns.
    fn coefficients<'py>(&self, py: Python<'py>, size: usize) -> PyResult<Array2<'py, f64>> {
        let transposed = self.models.coefficients(size);
        let responses = transposed.len() / size.max(1);
        table(py, transposed, responses, size)?.transpose()
    }

    /// (squares, parameters, ranks) of the fits with these numbers of columns.
    fn fits<'py>(
        &self,
        py: Python<'py>,
        sizes: PyReadonlyArray1<'py, i64>,
        threads: usize,
    ) -> PyResult<(Array1<'py, f64>, Array1<'py, f64>, Array1<'py, i64>)> {
        let sizes = numbers(&sizes)?;
        let fits = interruptible(py, f64::INFINITY, threads, |pool| self.models.fits(&sizes, pool))?;
        Ok((
            PyArray1::from_iter(py, fits.iter().map(|fit| fit.squares)),
            PyArray1::from_iter(py, fits.iter().map(|fit| fit.parameters)),
            PyArray1::from_iter(py, fits.iter().map(|fit| fit.rank as i64)),
        ))
    }

    /// (squares by size, number of sizes that are defined by pair) of each scheme, given as what is held out, what is
    /// validated, and the pairs to be visited. Without validated sets it is each datum alone.
    fn curves<'py>(
        &self,
        py: Python<'py>,
        schemes: Vec<(HeldOut<'py>, PyReadonlyArray1<'py, i64>)>,
        rows: ReadSets<'py>,
        sizes: PyReadonlyArray1<'py, i64>,
        threads: usize,
    ) -> PyResult<Vec<(Array1<'py, f64>, Array1<'py, i64>)>> {
        let lists = schemes
            .iter()
            .map(|(held, order)| Ok((held.read()?, numbers(order)?)))
            .collect::<PyResult<Vec<_>>>()?;
        let schemes: Vec<nested::Scheme<'_>> =
            lists.iter().map(|(listing, order)| listing.scheme(order)).collect();
        let (rows, sizes) = (sets(&rows.0, &rows.1)?, numbers(&sizes)?);
        let arrays = self.arrays.borrow(py)?;
        let problem = arrays.problem()?;
        let found = interruptible(py, f64::INFINITY, threads, |pool| {
            self.models.curves(&problem, &schemes, &rows, &sizes, pool)
        })?;
        Ok(found
            .into_iter()
            .map(|curve| (PyArray1::from_vec(py, curve.squares), indices(py, &curve.defined)))
            .collect())
    }
}

/// Neighbourhoods that are found when they are needed.
#[pyclass(frozen, module = "mexpress._core")]
struct Around(neighbours::Around);

#[pymethods]
impl Around {
    #[staticmethod]
    fn within(py: Python<'_>, points: PyReadonlyArray2<'_, f64>, radius: f64) -> PyResult<Self> {
        let (dimension, points) = (points.shape()[1], matrix(&points)?);
        Ok(Self(py.detach(|| neighbours::Around::within(points, dimension, radius))?))
    }

    #[staticmethod]
    fn nearest(py: Python<'_>, points: PyReadonlyArray2<'_, f64>, k: usize) -> PyResult<Self> {
        let (dimension, points) = (points.shape()[1], matrix(&points)?);
        Ok(Self(py.detach(|| neighbours::Around::nearest(points, dimension, k))?))
    }

    #[getter]
    fn mean(&self) -> f64 {
        self.0.mean
    }
}

/// What pairs hold out: listed sets with the validated ones, or neighbourhoods of data that are validated alone.
#[derive(FromPyObject)]
enum HeldOut<'py> {
    Listed(ReadSets<'py>, ReadSets<'py>),
    #[pyo3(transparent)]
    Around(PyRef<'py, Around>),
}

enum Listing<'a> {
    Sets(Sets, Sets),
    Around(&'a neighbours::Around),
}

impl HeldOut<'_> {
    fn read(&self) -> PyResult<Listing<'_>> {
        match self {
            Self::Listed(held, validated) => {
                Ok(Listing::Sets(sets(&held.0, &held.1)?, sets(&validated.0, &validated.1)?))
            }
            Self::Around(around) => Ok(Listing::Around(&around.0)),
        }
    }
}

impl Listing<'_> {
    fn scheme<'a>(&'a self, order: &'a [usize]) -> nested::Scheme<'a> {
        match self {
            Self::Sets(held, validated) => {
                nested::Scheme { held: nested::Held::Sets(held), validated, order }
            }
            Self::Around(around) => {
                nested::Scheme { held: nested::Held::Around(around), validated: &around.own, order }
            }
        }
    }
}

/// Row and column of the first entry that is NaN or infinite.
#[pyfunction]
fn find_not_finite(py: Python<'_>, values: PyReadonlyArray2<'_, f64>) -> PyResult<Option<(usize, usize)>> {
    let columns = values.shape()[1];
    let values = matrix(&values)?;
    // Blocks without an early exit vectorise: one pass at the speed of memory.
    let first = py.detach(|| {
        values.chunks(4096).enumerate().find_map(|(b, block)| {
            let finite = block.iter().fold(true, |finite, x| finite & x.is_finite());
            if finite { None } else { block.iter().position(|x| !x.is_finite()).map(|i| b * 4096 + i) }
        })
    });
    Ok(first.map(|i| (i / columns, i % columns)))
}

/// The points in the order of a curve that fills the space.
#[pyfunction]
fn along_curve<'py>(py: Python<'py>, points: PyReadonlyArray2<'py, f64>) -> PyResult<Array1<'py, i64>> {
    let dimension = points.shape()[1];
    let points = matrix(&points)?;
    let order = py.detach(|| hilbert::along_curve(points, dimension))?;
    Ok(indices(py, &order))
}

/// Neighbourhoods of points within a radius, as (offsets, items).
#[pyfunction]
fn neighbours_within<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    radius: f64,
    threads: usize,
) -> PyResult<Arrays<'py>> {
    let dimension = points.shape()[1];
    let points = matrix(&points)?;
    let found = interruptible(py, f64::INFINITY, threads, |pool| {
        neighbours::within(points, dimension, radius, pool)
    })?;
    Ok(arrays(py, &found))
}

/// The k nearest of each point, itself counted, as (offsets, items).
#[pyfunction]
fn neighbours_nearest<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    k: usize,
    threads: usize,
) -> PyResult<Arrays<'py>> {
    let dimension = points.shape()[1];
    let points = matrix(&points)?;
    let found =
        interruptible(py, f64::INFINITY, threads, |pool| neighbours::nearest(points, dimension, k, pool))?;
    Ok(arrays(py, &found))
}

/// Neighbourhoods that leave every point as far from its nearest as queries are from theirs, as (offsets, items).
#[pyfunction]
fn neighbours_matched<'py>(
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
    Ok(arrays(py, &found))
}

/// Each point with its neighbours in the Delaunay triangulation, as (offsets, items).
#[pyfunction]
fn neighbours_delaunay<'py>(py: Python<'py>, points: PyReadonlyArray2<'py, f64>) -> PyResult<Arrays<'py>> {
    let points = matrix(&points)?;
    let found = interruptible(py, f64::INFINITY, 1, |pool| delaunay::delaunay(points, pool))?;
    Ok(arrays(py, &found))
}

/// Lloyd's algorithm over samples of a region.
#[pyfunction]
fn lloyd<'py>(
    py: Python<'py>,
    samples: PyReadonlyArray2<'py, f64>,
    start: PyReadonlyArray2<'py, f64>,
    max_steps: usize,
    tolerance: f64,
    threads: usize,
) -> PyResult<Array2<'py, f64>> {
    let count = start.shape()[0];
    let cost = (samples.shape()[0] * count * max_steps) as f64;
    let (samples, start) = (matrix(&samples)?, matrix(&start)?);
    let centres =
        interruptible(py, cost, threads, |pool| lloyd::lloyd(samples, start, max_steps, tolerance, pool))?;
    table(py, centres, count, 2)
}

/// Samples drawn for a start: indices.
#[pyfunction]
fn spread<'py>(
    py: Python<'py>,
    samples: PyReadonlyArray2<'py, f64>,
    draws: PyReadonlyArray1<'py, f64>,
) -> PyResult<Array1<'py, i64>> {
    let cost = (samples.shape()[0] * draws.shape()[0]) as f64;
    let (samples, draws) = (matrix(&samples)?, slice(&draws)?);
    let drawn = interruptible(py, cost, 1, |pool| lloyd::spread(samples, draws, pool))?;
    Ok(indices(py, &drawn))
}

/// The data that become control points, in the order of their arrival.
#[pyfunction]
fn arrival<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    values: PyReadonlyArray2<'py, f64>,
    first: [usize; 3],
    max_count: usize,
    min_distance: f64,
    threads: usize,
) -> PyResult<Array1<'py, i64>> {
    let count = max_count.min(points.shape()[0]);
    let cost = 2.0 * points.shape()[0] as f64 * (count as f64).powi(2);
    let (points, values) = (matrix(&points)?, matrix(&values)?);
    let chosen = interruptible(py, cost, threads, |pool| {
        by_residual::arrival(points, values, first, max_count, min_distance, pool)
    })?;
    Ok(indices(py, &chosen))
}

/// The Rust core of mexpress.
#[pymodule(gil_used = false)]
mod _core {
    #[pymodule_export]
    use super::{
        Around, Factor, Nested, along_curve, arrival, find_not_finite, lloyd, neighbours_delaunay,
        neighbours_matched, neighbours_nearest, neighbours_within, spread,
    };
}
