//! The boundary to Python. The only folder that names PyO3: arrays in, arrays out, the interpreter released in between.
//!
//! Checks that deserve a sentence are made in Python; what is checked here keeps memory safe, no more.

mod arrays;
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
    #[pymodule_export]
    use super::arrays::{are_sets, largest};
    #[pymodule_export]
    use super::evaluate::{LocalFunctions, preimages_of, spline_slopes, spline_values};
    #[pymodule_export]
    use super::factor::Factor;
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
}
