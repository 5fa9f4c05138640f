//! The basis of a well-conditioned design, by products of matrices: `Q = A R^-1` with R from the Gram matrix, twice.
//!
//! The Gram matrix squares the condition, so the first basis is orthonormal to some digits only; the second time it is so to
//! rounding (CholeskyQR2; Yamamoto, Nakatsukasa, Yanagisawa and Fukaya, ETNA 44, 2015). Rows are solved one by one, so those
//! that are small beside others keep their digits, which reflections lose.

use crate::error::Error;
use crate::fit::factor::{Basis, Problem};
use crate::fit::lead::Lead;
use crate::fit::linalg;
use crate::fit::panels::{self, BLOCK, Lanes, PANEL};
use crate::fit::rank::Spectrum;
use crate::fit::residuals::{Part, Remainder, Step};
use crate::pool::Pool;

/// Pivots of a Gram matrix of unit columns, squares, below which the second time would not be enough either.
const LEAST_PIVOT: f64 = 1e-12;

/// How far the first basis may be from orthonormal: any further, and so is the second.
const FARTHEST: f64 = 1e-2;

/// Rows of a task, whose Gram matrices are added up: some dozens of tasks, and few sums to keep.
fn task_rows(rows: usize) -> usize {
    (rows / 64).next_multiple_of(BLOCK).max(8 * BLOCK)
}

/// An orthonormal basis of the columns, as many as their rank in so many rows; none if digits would be lost.
pub(super) fn orthonormal(
    problem: &Problem<'_>,
    scales: &[f64],
    counted: usize,
    pool: &Pool<'_>,
) -> Result<Option<Basis>, Error> {
    let (rows, columns) = (problem.total_rows(), problem.columns);
    // Rows that fill no panel take no longer to reflect.
    if rows < columns.max(PANEL) {
        return Ok(None);
    }
    let mut tasks = Tasks::new(rows, columns);
    let (gram, _) = tasks.gram(0, pool, |first, block, _| {
        panels::pack(|i| problem.row(i), rows, scales, first, block);
    })?;
    let Some(coarse) = unit_cholesky(gram, columns, pool)? else { return Ok(None) };
    let responses = problem.responses.len() / problem.rows;
    let (gram, mut projection) = tasks.gram(responses, pool, |first, block, sums| {
        panels::solve(&coarse, columns, columns, block);
        project(problem, responses, first, block, sums);
    })?;
    if distance_to_identity(&gram, columns) > FARTHEST {
        return Ok(None);
    }
    let Some(fine) = panels::cholesky(gram, columns, pool)? else { return Ok(None) };
    linalg::solve_lower(&fine, columns, &mut projection, responses);
    let triangle = triangle(&coarse, &fine, columns, pool)?;
    let spectrum = Spectrum::new(&triangle, columns, columns, counted, pool)?;
    if spectrum.rank < columns {
        return Ok(None);
    }
    let lead = Lead::new(problem, &spectrum, scales, projection.clone());
    let mut remainder = Remainder::new((lead.left(problem, pool)?, responses), (rows, columns));
    let step = Step { taken: Some(&lead.projection), project: true };
    let basis = tasks.rows(remainder.parts(task_rows(rows)), step, pool, |block| {
        panels::solve(&fine, columns, columns, block);
    })?;
    let residuals = remainder.finish(&basis, projection, pool)?;
    Ok(Some(Basis { rows: basis, spectrum, residuals }))
}

/// A matrix in panels, cut into tasks of some blocks.
struct Tasks {
    /// Panel after panel; rows beyond the last are zero.
    storage: Vec<f64>,
    rows: usize,
    columns: usize,
}

impl Tasks {
    fn new(rows: usize, columns: usize) -> Self {
        Self { storage: vec![0.0; rows.next_multiple_of(PANEL) * columns], rows, columns }
    }

    /// Changes every block, given its first row, and returns the lower triangle of the Gram matrix of all that results,
    /// column-major, and the total of what the changes add to sums, some for every column.
    fn gram(
        &mut self,
        sums: usize,
        pool: &Pool<'_>,
        change: impl Fn(usize, &mut [Lanes], &mut [f64]) + Sync,
    ) -> Result<(Vec<f64>, Vec<f64>), Error> {
        let (task, columns, square) = (task_rows(self.rows), self.columns, self.columns * self.columns);
        let size = square + sums * columns;
        let mut parts = vec![0.0; self.rows.div_ceil(task) * size];
        pool.run(
            self.storage.chunks_mut(task * columns).zip(parts.chunks_exact_mut(size)).enumerate(),
            || (),
            |(), (k, (rows, part))| {
                let (gram, sums) = part.split_at_mut(square);
                // Once called off, nobody reads the result.
                let called =
                    rows.chunks_mut(BLOCK * columns).enumerate().take_while(|_| pool.proceed().is_ok());
                for (l, block) in called {
                    let (block, _) = block.as_chunks_mut();
                    change(k * task + l * BLOCK, block, sums);
                    panels::add_gram(block, columns, gram);
                }
            },
        )?;
        let (total, rest) = parts.split_at_mut(size);
        for part in rest.chunks_exact(size) {
            total.iter_mut().zip(part).for_each(|(total, part)| *total += part);
        }
        parts.truncate(size);
        let sums = parts.split_off(square);
        Ok((parts, sums))
    }

    /// Changes every block, and returns the matrix row by row, with which a part of a remainder takes a step on the way.
    fn rows(
        self,
        parts: Vec<Part<'_>>,
        step: Step<'_>,
        pool: &Pool<'_>,
        change: impl Fn(&mut [Lanes]) + Sync,
    ) -> Result<Vec<f64>, Error> {
        let Self { mut storage, rows, columns } = self;
        let tasks = storage.chunks_mut(task_rows(rows) * columns).zip(parts);
        pool.run(tasks.collect::<Vec<_>>().into_iter(), Vec::new, |scratch, (rows, mut part)| {
            for block in rows.chunks_mut(BLOCK * columns).take_while(|_| pool.proceed().is_ok()) {
                let (panels, _) = block.as_chunks_mut();
                change(panels);
                scratch.clear();
                scratch.extend_from_slice(panels);
                panels::unpack(scratch, columns, block);
                part.step(step, block);
            }
        })?;
        storage.truncate(rows * columns);
        Ok(storage)
    }
}

/// Adds the products of a block's columns with the weighted responses of its rows to sums, columns x responses.
fn project(problem: &Problem<'_>, responses: usize, first: usize, block: &[Lanes], sums: &mut [f64]) {
    // Penalty rows respond with zero.
    let there = problem.rows.saturating_sub(first).min(BLOCK).div_ceil(PANEL);
    if responses * there > 0 {
        let mut right = vec![[0.0; PANEL]; there * responses];
        let row = |i| (problem.responses_of(i, responses), problem.row(i).1);
        panels::pack(row, problem.rows, &vec![1.0; responses], first, &mut right);
        panels::add_products(block, problem.columns, &right, responses, sums);
    }
}

/// The Cholesky factor of a Gram matrix, factored with columns at unit length; none where these are too near dependence.
fn unit_cholesky(mut gram: Vec<f64>, columns: usize, pool: &Pool<'_>) -> Result<Option<Vec<f64>>, Error> {
    let norms: Vec<f64> = gram.iter().step_by(columns + 1).map(|square| square.sqrt()).collect();
    if norms.iter().any(|&norm| norm.is_nan() || norm <= 0.0) {
        return Ok(None);
    }
    let scale = |column: &mut [f64], by: &[f64], all: f64| {
        column.iter_mut().zip(by).for_each(|(x, by)| *x *= by * all);
    };
    let units: Vec<f64> = norms.iter().map(|norm| norm.recip()).collect();
    gram.chunks_exact_mut(columns).zip(&units).for_each(|(column, &unit)| scale(column, &units, unit));
    let Some(mut factor) = panels::cholesky(gram, columns, pool)? else { return Ok(None) };
    if factor.iter().step_by(columns + 1).any(|pivot| pivot * pivot < LEAST_PIVOT) {
        return Ok(None);
    }
    factor.chunks_exact_mut(columns).for_each(|column| scale(column, &norms, 1.0));
    Ok(Some(factor))
}

/// The Frobenius norm of the difference, of the lower triangle of a symmetric matrix.
fn distance_to_identity(gram: &[f64], columns: usize) -> f64 {
    let mut sum = 0.0;
    for (j, column) in gram.chunks_exact(columns).enumerate() {
        sum += (column[j] - 1.0).powi(2) + 2.0 * column[j + 1..].iter().map(|x| x * x).sum::<f64>();
    }
    sum.sqrt()
}

/// `(C F)^T` of two lower triangles: of A = Q1 C^T and Q1 = Q F^T it is the R of A = Q R. Sums run over rows in order.
fn triangle(coarse: &[f64], fine: &[f64], columns: usize, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
    let mut product = vec![0.0; columns * columns];
    for (j, (target, factors)) in
        product.chunks_exact_mut(columns).zip(fine.chunks_exact(columns)).enumerate()
    {
        pool.proceed()?;
        for k in j..columns {
            let column = &coarse[k * columns + k..(k + 1) * columns];
            target[k..].iter_mut().zip(column).for_each(|(x, c)| *x += c * factors[k]);
        }
    }
    Ok(linalg::transposed(&product, columns))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::fit::householder;
    use crate::fit::linalg::dot;

    static NEVER: AtomicBool = AtomicBool::new(false);

    /// Cosines of x for a design, entry by entry, times what `grade` says of the row.
    fn design(rows: usize, columns: usize, grade: impl Fn(usize) -> f64) -> Vec<f64> {
        let angle = |i: usize, j: usize| (i as f64 + 0.5) * j as f64 * std::f64::consts::PI / rows as f64;
        (0..rows * columns)
            .map(|k| (k / columns, k % columns))
            .map(|(i, j)| grade(i) * (1.5 + angle(i, j).cos()))
            .collect()
    }

    fn problem(design: &[f64], columns: usize) -> Problem<'_> {
        let rows = design.len() / columns;
        Problem { design, responses: &[], root_weights: None, penalty: &[], rows, columns }
    }

    fn basis(design: &[f64], columns: usize, threads: usize) -> Option<(Vec<f64>, Spectrum)> {
        let pool = Pool::new(threads, &NEVER);
        let found =
            orthonormal(&problem(design, columns), &vec![1.0; columns], design.len() / columns, &pool)
                .unwrap();
        found.map(|basis| (basis.rows, basis.spectrum))
    }

    /// R, column-major, of what was found.
    fn r_of(spectrum: &Spectrum) -> Vec<f64> {
        let order = spectrum.rank;
        let entry = |k: usize| spectrum.triangle[k] / spectrum.scales[k / order];
        (0..order * order).map(entry).collect()
    }

    #[test]
    fn the_basis_is_orthonormal_and_rebuilds_every_row() {
        // Rows of sizes from 1 to 1e-9 keep the digits that they have.
        for (rows, columns) in [(8, 1), (9, 3), (130, 17), (1500, 12)] {
            let a = design(rows, columns, |i| 0.1_f64.powi(i as i32 % 10));
            let (q, spectrum) = basis(&a, columns, 1).unwrap();
            let r = r_of(&spectrum);
            for (row, q) in a.chunks(columns).zip(q.chunks(columns)) {
                let largest = row.iter().fold(0.0, |l: f64, x| l.max(x.abs()));
                for (x, r) in row.iter().zip(r.chunks(columns)) {
                    assert!((x - dot(q, r)).abs() < 1e-12 * largest);
                }
            }
            for i in 0..columns {
                for j in 0..columns {
                    let product: f64 = q.chunks(columns).map(|q| q[i] * q[j]).sum();
                    assert!((product - f64::from(u8::from(i == j))).abs() < 1e-14, "{rows} x {columns}");
                }
            }
        }
    }

    #[test]
    fn it_spans_what_reflections_span() {
        let a = design(300, 9, |_| 1.0);
        let (q, _) = basis(&a, 9, 1).unwrap();
        let pool = Pool::new(1, &NEVER);
        let (reflected, _) =
            householder::orthonormal(&problem(&a, 9), &[1.0; 9], a.len() / 9, &pool).unwrap();
        for (q, other) in q.chunks(9).zip(reflected.chunks(9)) {
            // Of the same columns in the same order; signs are their own.
            q.iter().zip(other).for_each(|(x, y)| assert!((x.abs() - y.abs()).abs() < 1e-13));
        }
    }

    #[test]
    fn penalty_rows_and_weights_belong_to_the_design() {
        let (a, z) = (design(40, 3, |_| 1.0), [0.5, 0.0, 0.0, 0.0, 0.25, 1.0]);
        let weights: Vec<f64> = (1..=40).map(f64::from).collect();
        let given = Problem { root_weights: Some(&weights), penalty: &z, ..problem(&a, 3) };
        let whole: Vec<f64> = a.iter().enumerate().map(|(k, x)| x * weights[k / 3]).chain(z).collect();
        let found =
            orthonormal(&given, &[1.0; 3], given.total_rows(), &Pool::new(1, &NEVER)).unwrap().unwrap();
        assert_eq!(found.rows, basis(&whole, 3, 1).unwrap().0);
    }

    #[test]
    fn responses_are_projected_on_the_way() {
        for rows in [40, 128, 137, 3000_usize] {
            let (a, z) = (design(rows, 3, |_| 1.0), [0.5, 0.0, 0.0, 0.0, 0.25, 1.0]);
            let weights: Vec<f64> = (0..rows).map(|i| 1.0 + (i % 7) as f64).collect();
            let responses: Vec<f64> = (0..2 * rows).map(|k| (k as f64).sin()).collect();
            let given = Problem {
                responses: &responses,
                root_weights: Some(&weights),
                penalty: &z,
                ..problem(&a, 3)
            };
            for threads in [1, 3] {
                let found = orthonormal(&given, &[1.0; 3], given.total_rows(), &Pool::new(threads, &NEVER))
                    .unwrap()
                    .unwrap();
                let projection = found.residuals.projection;
                for (k, x) in projection.iter().enumerate() {
                    let (c, j) = (k / 3, k % 3);
                    let terms = (0..rows).map(|i| found.rows[3 * i + j] * weights[i] * responses[2 * i + c]);
                    assert!((x - terms.sum::<f64>()).abs() < 1e-12, "{rows} rows, {c} {j}");
                }
                assert_eq!(projection.len(), 6);
            }
        }
    }

    #[test]
    fn a_column_near_others_is_left_to_reflections() {
        for (off, found) in [(1e-2, true), (1e-8, false), (0.0, false)] {
            let mut a = design(200, 4, |_| 1.0);
            for (i, row) in a.chunks_mut(4).enumerate() {
                row[3] = row[1] + row[2] + off * (i as f64).sin();
            }
            assert_eq!(basis(&a, 4, 1).is_some(), found, "{off}");
        }
        assert!(basis(&design(3, 5, |_| 1.0), 5, 1).is_none(), "fewer rows than columns");
        assert!(basis(&[0.0; 20], 1, 1).is_none(), "a column of zeros");
    }

    #[test]
    fn no_bit_depends_on_threads_or_on_columns_that_follow() {
        let (rows, columns) = (2500, 20);
        let a = design(rows, columns, |i| 1.0 + i as f64);
        let (whole, _) = basis(&a, columns, 1).unwrap();
        for threads in [2, 5] {
            assert_eq!(basis(&a, columns, threads).unwrap().0, whole);
        }
        for some in [1, 2, 3, 7, 13, 19] {
            let leading: Vec<f64> = a.chunks(columns).flat_map(|row| &row[..some]).copied().collect();
            let (q, _) = basis(&leading, some, 1).unwrap();
            assert!(
                q.chunks(some).zip(whole.chunks(columns)).all(|(q, whole)| q == &whole[..some]),
                "{some}"
            );
        }
    }
}
