//! The boundary to Python. The only folder that names PyO3: arrays in, arrays out, the interpreter released in between.
//!
//! Checks that deserve a sentence are made in Python; what is checked here keeps memory safe, no more.

mod arrays;
mod batch;
mod bending;
mod evaluate;
mod factor;
mod interrupt;
mod near;
mod nested;
mod penalty_path;
mod place;
mod problem;
mod scheme;

use pyo3::prelude::*;

/// The Rust core of mexpress.
#[pymodule(gil_used = false)]
mod _core {
    use numpy::{PyArray1, PyArrayMethods};
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::arrays::{are_sets, largest};
    #[pymodule_export]
    use super::batch::cross_validate_batch;
    #[pymodule_export]
    use super::bending::{cardinal_splines, leading_bending, product, reduced_bending};
    #[pymodule_export]
    use super::evaluate::{LocalFunctions, preimages_of, spline_slopes, spline_values};
    #[pymodule_export]
    use super::factor::{Factor, triangles};
    #[pymodule_export]
    use super::near::{
        LazyNeighbourhoods, hilbert_order, neighbours_delaunay, neighbours_matched, neighbours_nearest,
        neighbours_within,
    };
    #[pymodule_export]
    use super::nested::Nested;
    #[pymodule_export]
    use super::penalty_path::PenaltyPath;
    #[pymodule_export]
    use super::place::{lloyd, place_by_residual, spread};

    /// NumPy's interface is loaded when it is first used, by an import that Ctrl-C breaks off: a panic. So it is used here.
    #[pymodule_init]
    fn load_numpy(module: &Bound<'_, PyModule>) -> PyResult<()> {
        PyArray1::<f64>::zeros(module.py(), 0, false).try_readonly()?;
        Ok(())
    }
}
