//! The basis of any design, by reflections.
//!
//! Tall designs are cut into blocks of rows. Each block is factored on its own, the triangles are stacked and
//! factored once more, and the basis is multiplied out block by block: Householder reflections throughout, so
//! badly scaled columns lose nothing, and memory is that of one basis.

use crate::error::Error;
use crate::fit::factor::Problem;
use crate::fit::linalg::{self, QrScratch};
use crate::fit::rank::Spectrum;
use crate::fit::turn::Turn;
use crate::pool::Pool;

/// An orthonormal basis of the columns, row-major and `rank` wide, and what their triangle tells.
pub(super) fn orthonormal(
    problem: &Problem<'_>,
    scales: &[f64],
    counted: usize,
    pool: &Pool<'_>,
) -> Result<(Vec<f64>, Spectrum), Error> {
    let leaves = Leaves::factor(problem, scales, pool)?;
    let top = Top::new(&leaves, counted, pool)?;
    Ok((leaves.basis(&top, pool)?, top.spectrum))
}

/// Rows of a block, if columns are few.
const LEAF_ROWS: usize = 2000;

/// A block's triangle is at most a sixteenth of it, so that the stack of triangles stays cheap.
fn block_rows(columns: usize) -> usize {
    LEAF_ROWS.max(16 * columns)
}

/// Blocks of rows, each with its own QR factorisation; column-major inside a block.
struct Leaves {
    storage: Vec<f64>,
    reflectors: Vec<f64>,
    rows: usize,
    columns: usize,
    block: usize,
}

impl Leaves {
    fn factor(problem: &Problem<'_>, scales: &[f64], pool: &Pool<'_>) -> Result<Self, Error> {
        let columns = problem.columns;
        let rows = problem.total_rows();
        let block = block_rows(columns).min(rows);
        let count = rows.div_ceil(block);
        let size = linalg::reflector_size(block, columns);
        let mut storage = vec![0.0; rows * columns];
        let mut reflectors = vec![0.0; count * size];
        let tasks = storage.chunks_mut(block * columns).zip(reflectors.chunks_exact_mut(size)).enumerate();
        pool.run(
            tasks,
            || QrScratch::new(block, columns),
            |scratch, (i, (a, h))| {
                let height = a.len() / columns;
                load(problem, scales, i * block, a, height);
                let h = &mut h[..linalg::reflector_size(height, columns)];
                // Once called off, nobody reads the result.
                let _ = linalg::qr_in_place(a, height, columns, h, scratch, pool);
            },
        )?;
        Ok(Self { storage, reflectors, rows, columns, block })
    }

    fn triangle_rows(&self, i: usize) -> usize {
        self.columns.min(self.block.min(self.rows - i * self.block))
    }

    fn count(&self) -> usize {
        self.rows.div_ceil(self.block)
    }

    /// The blocks' triangles on top of each other, column-major.
    fn stack(&self) -> (Vec<f64>, usize) {
        let height: usize = (0..self.count()).map(|i| self.triangle_rows(i)).sum();
        let mut stack = vec![0.0; height * self.columns];
        let mut above = 0;
        for (i, block) in self.storage.chunks(self.block * self.columns).enumerate() {
            let rows = block.len() / self.columns;
            for j in 0..self.columns {
                let kept = self.triangle_rows(i).min(j + 1);
                let at = j * height + above;
                stack[at..at + kept].copy_from_slice(&block[j * rows..j * rows + kept]);
            }
            above += self.triangle_rows(i);
        }
        (stack, height)
    }

    /// Multiplies the basis out in place, row-major, `top.rank` wide.
    fn basis(self, top: &Top, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        let Self { mut storage, reflectors, rows, columns, block } = self;
        let rank = top.spectrum.rank;
        let size = linalg::reflector_size(block, columns);
        let tasks = storage.chunks_mut(block * columns).zip(reflectors.chunks_exact(size)).enumerate();
        pool.run(
            tasks,
            || (QrScratch::new(block, columns), vec![0.0; block * columns]),
            |(scratch, c), (i, (a, h))| {
                let height = a.len() / columns;
                let c = &mut c[..height * rank];
                let kept = columns.min(height);
                for (target, source) in c.chunks_exact_mut(height).zip(top.basis.chunks_exact(top.height)) {
                    let start = i * block.min(columns);
                    target[..kept].copy_from_slice(&source[start..start + kept]);
                    target[kept..].fill(0.0);
                }
                let h = &h[..linalg::reflector_size(height, columns)];
                let _ = linalg::apply_q(a, (height, columns), h, c, scratch, pool);
                for (k, row) in
                    a.chunks_exact_mut(columns).enumerate().take(if rank > 0 { height } else { 0 })
                {
                    row.iter_mut().zip(c[k..].iter().step_by(height)).for_each(|(q, &c)| *q = c);
                }
            },
        )?;
        if rank < columns {
            for i in 1..rows {
                storage.copy_within(i * columns..i * columns + rank, i * rank);
            }
            storage.truncate(rows * rank);
        }
        Ok(storage)
    }
}

/// Rows `first..` of `[W^1/2 A; Z]` with scaled columns, column-major.
fn load(problem: &Problem<'_>, scales: &[f64], first: usize, block: &mut [f64], height: usize) {
    for k in 0..height {
        let (row, weight) = problem.row(first + k);
        for ((j, a), scale) in row.iter().enumerate().zip(scales) {
            block[j * height + k] = a * scale * weight;
        }
    }
}

/// The stacked triangles, factored: the small end of the factorisation, where rank is decided.
struct Top {
    /// Orthonormal columns that the leaves' reflections turn into the basis; height x rank.
    basis: Vec<f64>,
    height: usize,
    spectrum: Spectrum,
}

impl Top {
    fn new(leaves: &Leaves, counted: usize, pool: &Pool<'_>) -> Result<Self, Error> {
        let columns = leaves.columns;
        let (stack, height) = leaves.stack();
        let size = height.min(columns);
        let (stack, turn) = match leaves.count() {
            0 | 1 => (stack, None),
            _ => (Vec::new(), Some(Turn::new(stack, height, columns, pool)?)),
        };
        let reflected = turn.as_ref().map_or(&stack, |turn| &turn.reflected);
        let spectrum = Spectrum::new(reflected, height, columns, counted, pool)?;
        let mut basis = vec![0.0; height * spectrum.rank];
        for (j, column) in basis.chunks_exact_mut(height).enumerate() {
            match &spectrum.turn {
                None => column[j] = 1.0,
                Some(u) => column[..size].copy_from_slice(&u[j * size..(j + 1) * size]),
            }
        }
        if let Some(turn) = turn {
            turn.apply(&mut basis, pool)?;
        }
        Ok(Self { basis, height, spectrum })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::fit::linalg::dot;

    fn found(design: &[f64], columns: usize, threads: usize) -> (Vec<f64>, Spectrum) {
        let never = AtomicBool::new(false);
        let rows = design.len() / columns;
        let problem = Problem { design, responses: &[], root_weights: None, penalty: &[], rows, columns };
        orthonormal(&problem, &vec![1.0; columns], rows, &Pool::new(threads, &never)).unwrap()
    }

    /// The largest differences of `Q^T Q` from the identity, and of `Q R` from the design.
    fn errors(design: &[f64], columns: usize) -> (f64, f64) {
        let (q, spectrum) = found(design, columns, 1);
        let rank = spectrum.rank;
        let (mut off, mut wrong) = (0.0_f64, 0.0_f64);
        for k in 0..rank * rank {
            let product: f64 = q.chunks(rank).map(|q| q[k / rank] * q[k % rank]).sum();
            off = off.max((product - f64::from(u8::from(k / rank == k % rank))).abs());
        }
        for (row, q) in design.chunks(columns).zip(q.chunks(rank)) {
            for ((x, r), scale) in row.iter().zip(spectrum.triangle.chunks(rank)).zip(&spectrum.scales) {
                wrong = wrong.max((x - dot(q, r) / scale).abs());
            }
        }
        (off, wrong)
    }

    fn powers(rows: usize, columns: usize) -> Vec<f64> {
        (0..rows * columns).map(|k| ((k / columns) as f64 / rows as f64).powi((k % columns) as i32)).collect()
    }

    #[test]
    fn a_basis_of_any_shape_is_orthonormal_and_rebuilds_the_design() {
        // Of one row, of fewer rows than columns, of one block, of three.
        for (rows, columns) in [(1, 1), (2, 5), (50, 12), (4500, 6)] {
            let (off, wrong) = errors(&powers(rows, columns), columns);
            assert!(off < 1e-13 && wrong < 1e-13, "{rows} x {columns}: {off}, {wrong}");
        }
    }

    #[test]
    fn dependent_columns_are_left_out_of_the_basis() {
        let twice: Vec<f64> =
            powers(30, 3).chunks(3).flat_map(|row| [row[0], row[1], row[2], row[1]]).collect();
        let (q, spectrum) = found(&twice, 4, 1);
        assert_eq!((spectrum.rank, q.len()), (3, 90));
        let (off, wrong) = errors(&twice, 4);
        assert!(off < 1e-13 && wrong < 1e-13);
        assert_eq!(found(&[0.0; 6], 2, 1).1.rank, 0);
    }

    #[test]
    fn no_bit_depends_on_threads() {
        let design = powers(6100, 4);
        let one = found(&design, 4, 1).0;
        assert!([2, 5].into_iter().all(|threads| found(&design, 4, threads).0 == one));
    }
}
