//! The reflections Q that take a matrix to its triangle.

use crate::error::Error;
use crate::fit::linalg::{self, QrScratch};
use crate::pool::Pool;

/// A matrix, reflected to its triangle in its place. Matrices are column-major.
pub(super) struct Turn {
    /// The triangle, and below it what the reflections are made of.
    pub reflected: Vec<f64>,
    reflectors: Vec<f64>,
    pub rows: usize,
    pub columns: usize,
}

impl Turn {
    pub fn new(mut reflected: Vec<f64>, rows: usize, columns: usize, pool: &Pool<'_>) -> Result<Self, Error> {
        let mut reflectors = vec![0.0; linalg::reflector_size(rows, columns)];
        let mut scratch = QrScratch::new(rows, columns);
        linalg::qr_in_place(&mut reflected, rows, columns, &mut reflectors, &mut scratch, pool)?;
        Ok(Self { reflected, reflectors, rows, columns })
    }

    /// The triangle, square.
    pub fn triangle(&self) -> Vec<f64> {
        linalg::upper_triangle(&self.reflected, self.rows, self.columns)
    }

    /// `c <- Q c`.
    pub fn apply(&self, c: &mut [f64], pool: &Pool<'_>) -> Result<(), Error> {
        let shape = (self.rows, self.columns);
        linalg::apply_q(&self.reflected, shape, &self.reflectors, c, &mut self.scratch(c), pool)
    }

    /// `c <- Q^T c`.
    pub fn apply_transposed(&self, c: &mut [f64], pool: &Pool<'_>) -> Result<(), Error> {
        let shape = (self.rows, self.columns);
        linalg::apply_q_transposed(&self.reflected, shape, &self.reflectors, c, &mut self.scratch(c), pool)
    }

    fn scratch(&self, c: &[f64]) -> QrScratch {
        QrScratch::new(self.rows, self.columns.max(c.len() / self.rows.max(1)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{assert_close, noise, pool};

    #[test]
    fn reflections_take_a_matrix_to_its_triangle_and_back() {
        for (rows, columns) in [(1, 1), (9, 3), (70, 50)] {
            let matrix = noise(rows * columns, 6);
            let turn = Turn::new(matrix.clone(), rows, columns, &pool(1)).unwrap();
            let mut turned = matrix.clone();
            turn.apply_transposed(&mut turned, &pool(1)).unwrap();
            let above = |column: &[f64]| column[..columns].to_vec();
            let triangle: Vec<f64> = turned.chunks(rows).flat_map(above).collect();
            assert_close(&triangle, &turn.triangle(), 1e-14);
            turn.apply(&mut turned, &pool(1)).unwrap();
            assert_close(&turned, &matrix, 1e-14);
        }
    }
}
