//! The design's orthonormal basis, and what one fit tells: rank, coefficients, residuals, leverage.
//!
//! The basis is that of [`crate::fit::cholesky_qr`], or of [`crate::fit::householder`] where the first would lose digits. Work is
//! cut into blocks of rows that depend on the shape alone, never on the number of threads.

use crate::error::Error;
use crate::fit::linalg::{self, dot};
use crate::fit::rank::{first_deficient, numerical_rank};
use crate::fit::{cholesky_qr, householder};
use crate::pool::Pool;

/// A weighted, penalised least-squares problem: `min ||W^1/2 (b - A x)||^2 + ||Z x||^2`. Matrices are row-major.
pub struct Problem<'a> {
    /// A, `rows` x `columns`.
    pub design: &'a [f64],
    /// b, `rows` x `responses`.
    pub responses: &'a [f64],
    /// Square roots of the rows' weights, if they have any.
    pub root_weights: Option<&'a [f64]>,
    /// Z, any number of rows that are never held out.
    pub penalty: &'a [f64],
    /// Number of rows of A.
    pub rows: usize,
    /// Number of columns of A.
    pub columns: usize,
}

impl Problem<'_> {
    /// Row `i` of `[A; Z]`, and the root of its weight.
    pub(super) fn row(&self, i: usize) -> (&[f64], f64) {
        let p = self.columns;
        match i.checked_sub(self.rows) {
            None => (&self.design[i * p..(i + 1) * p], self.root_weights.map_or(1.0, |w| w[i])),
            Some(i) => (&self.penalty[i * p..(i + 1) * p], 1.0),
        }
    }

    /// Rows of `[A; Z]`.
    pub(super) fn total_rows(&self) -> usize {
        self.rows + self.penalty.len() / self.columns
    }

    /// Responses of row `i`; none of a penalty row.
    fn responses_of(&self, i: usize, count: usize) -> &[f64] {
        self.responses.get(i * count..(i + 1) * count).unwrap_or_default()
    }

    /// A number that changes with any digit of row `i`.
    fn fingerprint(&self, i: usize, responses: usize) -> u64 {
        let (row, weight) = self.row(i);
        let mix = |sum: u64, x: &f64| (sum.rotate_left(7) ^ x.to_bits()).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        // Four sums side by side: one multiplication need not wait for another.
        let (fours, rest) = row.as_chunks::<4>();
        let mut sums = [weight.to_bits(), 1, 2, 3];
        for four in fours {
            sums.iter_mut().zip(four).for_each(|(sum, x)| *sum = mix(*sum, x));
        }
        let sum = self.responses_of(i, responses).iter().chain(rest).fold(sums[0], mix);
        sums[1..].iter().fold(sum, |sum, other| mix(sum, &f64::from_bits(*other)))
    }

    fn fingerprints(&self, pool: &Pool<'_>) -> Result<Vec<u64>, Error> {
        let responses = self.responses.len() / self.rows;
        let mut all = vec![0; self.total_rows()];
        let parts = all.chunks_mut(LEAF_ROWS).enumerate();
        pool.run(
            parts,
            || (),
            |(), (part, prints)| {
                for (k, print) in prints.iter_mut().enumerate() {
                    *print = self.fingerprint(part * LEAF_ROWS + k, responses);
                }
            },
        )?;
        Ok(all)
    }

    /// What brings the columns of `[W^1/2 A; Z]` to unit length.
    fn unit_scales(&self, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        let powers = column_scales(self, pool)?;
        let mut squares = vec![0.0; self.columns];
        for i in 0..self.total_rows() {
            let (row, weight) = self.row(i);
            for ((square, a), power) in squares.iter_mut().zip(row).zip(&powers) {
                *square += (a * power * weight).powi(2);
            }
        }
        let unit = |(power, square): (f64, f64)| if square > 0.0 { power / square.sqrt() } else { power };
        Ok(powers.into_iter().zip(squares).map(unit).collect())
    }

    fn check(&self) -> Result<usize, Error> {
        if self.rows.min(self.columns) == 0 {
            return Err(Error::Length { expected: 1, given: 0 });
        }
        expect_length(self.design.len(), self.rows * self.columns)?;
        expect_length(self.penalty.len() % self.columns, 0)?;
        let responses = self.responses.len() / self.rows;
        expect_length(self.responses.len(), self.rows * responses)?;
        self.root_weights.map_or(Ok(()), |weights| expect_length(weights.len(), self.rows))?;
        Ok(responses)
    }
}

/// A fitted problem, ready for any held-out set.
pub struct Factor {
    /// Rows of the design.
    pub rows: usize,
    /// Columns of the design.
    pub columns: usize,
    /// Columns of the responses.
    pub responses: usize,
    /// Rank of the design with its penalty rows.
    pub rank: usize,
    /// Rows of the design and of the penalty.
    pub(crate) total_rows: usize,
    /// Q, row-major, `rank` wide: an orthonormal basis of the weighted design's columns, penalty rows last.
    pub basis: Vec<f64>,
    /// `Q^T A` with A's columns at unit length: rank x columns, column-major. Tells rank from rounding.
    pub(crate) triangle: Vec<f64>,
    /// A lower bound on the smallest singular value of `triangle` that counts for the rank.
    pub(crate) least: f64,
    /// Below this, relative to the largest, a singular value is rounding.
    pub(crate) tolerance: f64,
    /// What brings columns of the problem to unit length.
    pub(crate) scales: Vec<f64>,
    /// x, columns x responses, column-major.
    pub coefficients: Vec<f64>,
    /// Columns of the design that span them all, if some depend on the others.
    spanning: Option<Vec<usize>>,
    /// What each row of the problem was, to notice that it has changed.
    fingerprints: Vec<u64>,
    /// Weighted residuals, rows x responses, row-major; those of the penalty rows, `0 - Z x`, last.
    pub(crate) residuals: Vec<f64>,
    /// `Q^T b` of the weighted responses, responses x rank.
    pub(crate) projection: Vec<f64>,
    /// Diagonal of the hat matrix.
    pub leverage: Vec<f64>,
    /// Square roots of the weights.
    pub(crate) root_weights: Option<Vec<f64>>,
}

impl Factor {
    /// Factors and fits.
    pub fn new(problem: &Problem<'_>, pool: &Pool<'_>) -> Result<Self, Error> {
        let responses = problem.check()?;
        let scales = column_scales(problem, pool)?;
        let (basis, spectrum) = match cholesky_qr::orthonormal(problem, &scales, pool)? {
            Some(found) => found,
            None => householder::orthonormal(problem, &scales, pool)?,
        };
        let mut factor = Self::fit(problem, basis, spectrum.rank, pool)?;
        factor.coefficients = spectrum.solve(&factor.projection, responses);
        for column in factor.coefficients.chunks_exact_mut(problem.columns) {
            column.iter_mut().zip(&scales).for_each(|(x, s)| *x *= s);
        }
        factor.least = spectrum.least;
        factor.tolerance = spectrum.tolerance;
        factor.triangle = spectrum.triangle;
        factor.scales = spectrum.scales.iter().zip(&scales).map(|(unit, power)| unit * power).collect();
        if factor.rank < factor.columns {
            factor.spanning = Some(factor.spanning_columns());
        }
        Ok(factor)
    }

    /// Fits a problem of which the columns of `[W^1/2 A; Z]` are orthonormal already. They are so to rounding, which rows
    /// of zeros lose: pairs close to rank loss go back to `source`, a problem with the same responses, weights and span.
    pub fn orthonormal(problem: &Problem<'_>, source: &Problem<'_>, pool: &Pool<'_>) -> Result<Self, Error> {
        problem.check()?;
        source.check()?;
        let columns = problem.columns;
        expect_length(source.columns, columns)?;
        expect_length(source.rows, problem.rows)?;
        let mut basis = [problem.design, problem.penalty].concat();
        if let Some(weights) = problem.root_weights {
            for (row, w) in basis.chunks_exact_mut(columns).zip(weights) {
                row.iter_mut().for_each(|x| *x *= w);
            }
        }
        let mut factor = Self::fit(problem, basis, columns, pool)?;
        factor.coefficients.clone_from(&factor.projection);
        factor.triangle.resize(columns * columns, 0.0);
        factor.triangle.iter_mut().step_by(columns + 1).for_each(|diagonal| *diagonal = 1.0);
        factor.scales = source.unit_scales(pool)?;
        factor.fingerprints = source.fingerprints(pool)?;
        factor.least = 1.0;
        factor.tolerance = factor.total_rows.max(columns) as f64 * f64::EPSILON;
        Ok(factor)
    }

    /// What a basis tells of the responses, without coefficients.
    fn fit(problem: &Problem<'_>, basis: Vec<f64>, rank: usize, pool: &Pool<'_>) -> Result<Self, Error> {
        let Problem { rows, columns, .. } = *problem;
        let responses = problem.responses.len() / rows;
        let mut factor = Self {
            rows,
            columns,
            responses,
            rank,
            total_rows: problem.total_rows(),
            basis,
            triangle: Vec::new(),
            least: 0.0,
            tolerance: 0.0,
            scales: Vec::new(),
            coefficients: Vec::new(),
            spanning: None,
            fingerprints: problem.fingerprints(pool)?,
            residuals: weighted_responses(problem, responses),
            leverage: Vec::new(),
            projection: Vec::new(),
            root_weights: problem.root_weights.map(<[f64]>::to_vec),
        };
        factor.projection = factor.project(&factor.residuals, pool)?;
        // Twice: residuals far smaller than the responses keep a part in Q that is rounding of the responses.
        let rest = factor.subtract(&factor.projection.clone(), pool)?;
        factor.subtract(&rest, pool)?;
        factor.projection.iter_mut().zip(&rest).for_each(|(c, rest)| *c += rest);
        factor.leverage = factor.squared_lengths(pool)?;
        Ok(factor)
    }

    /// The lambda_min(M) from which the closed form holds, M of a pair being `I - Q_K^T Q_K`: its error is about
    /// eps / lambda_min(M), of which nine digits are left at 2e-6. The training rows' least singular value is at least that
    /// of all rows times the root of lambda_min(M), so the rank of a design near rank loss asks for more. Estimates of
    /// lambda_min(M) may be ten times too large.
    pub(crate) fn closed_form_least(&self) -> f64 {
        let beyond_doubt = 2.0 * self.tolerance * (self.columns as f64).sqrt() / self.least;
        if self.rank == 0 { 2e-6 } else { f64::max(2e-6, 10.0 * beyond_doubt * beyond_doubt) }
    }

    /// Row `i` of the basis.
    pub fn basis_row(&self, i: usize) -> &[f64] {
        &self.basis[i * self.rank..(i + 1) * self.rank]
    }

    /// Weighted residuals of row `i`.
    pub(crate) fn residual_row(&self, i: usize) -> &[f64] {
        &self.residuals[i * self.responses..(i + 1) * self.responses]
    }

    /// Row `i` of the problem in coordinates in which it has full rank, then its right-hand side. Those of A are the
    /// best: the basis is good to rounding of the largest entries only, which small training rows feel.
    pub(crate) fn full_rank_row(
        &self,
        problem: &Problem<'_>,
        i: usize,
        out: &mut [f64],
    ) -> Result<(), Error> {
        if problem.fingerprint(i, self.responses) != self.fingerprints[i] {
            return Err(Error::Changed { row: i });
        }
        let (left, right) = out.split_at_mut(self.rank);
        let (row, weight) = problem.row(i);
        match &self.spanning {
            None => {
                for ((x, a), scale) in left.iter_mut().zip(row).zip(&self.scales) {
                    *x = a * scale * weight;
                }
            }
            Some(columns) => {
                for (x, &j) in left.iter_mut().zip(columns) {
                    *x = row[j] * self.scales[j] * weight;
                }
            }
        }
        for (x, b) in right.iter_mut().zip(problem.responses_of(i, self.responses)) {
            *x = b * weight;
        }
        if i >= self.rows {
            right.fill(0.0);
        }
        Ok(())
    }

    /// Rows of the problem that pairs close to rank loss go back to.
    pub(crate) fn problem_rows(&self) -> usize {
        self.fingerprints.len()
    }

    /// What brings row `i` back from weighted to plain units.
    pub(crate) fn unweight(&self, i: usize) -> f64 {
        self.root_weights.as_ref().map_or(1.0, |w| w[i].recip())
    }

    /// Residuals in the responses' unit, rows x responses, row-major.
    pub fn plain_residuals(&self) -> Vec<f64> {
        (0..self.rows).flat_map(|i| self.residual_row(i).iter().map(move |e| e * self.unweight(i))).collect()
    }

    /// `Q^T b`, rank x responses, column-major, of weighted responses. Summed block by block, so that the order of the sum
    /// does not depend on who computes it.
    pub(crate) fn project(&self, right: &[f64], pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        let (rank, responses) = (self.rank, self.responses);
        let size = rank * responses;
        if size == 0 {
            return Ok(Vec::new());
        }
        let mut parts = vec![0.0; right.len().div_ceil(LEAF_ROWS * responses) * size];
        let (basis, right) = (self.basis.chunks(LEAF_ROWS * rank), right.chunks(LEAF_ROWS * responses));
        pool.run(
            parts.chunks_exact_mut(size).zip(basis).zip(right),
            || (),
            |(), ((part, q), b)| linalg::transposed_product(q, b, rank, responses, part),
        )?;
        Ok(sum_of_parts(&parts, size))
    }

    /// The columns that are independent of those before them, as many as the rank, increasing.
    pub(crate) fn independent_columns(&self, pool: &Pool<'_>) -> Result<Vec<usize>, Error> {
        let column = |j: usize| &self.triangle[j * self.rank..(j + 1) * self.rank];
        let mut directions: Vec<Vec<f64>> = Vec::new();
        let mut kept = Vec::new();
        for j in 0..self.columns {
            pool.proceed()?;
            let mut rest = column(j).to_vec();
            for _ in 0..2 {
                for direction in &directions {
                    let along = dot(direction, &rest);
                    rest.iter_mut().zip(direction).for_each(|(x, d)| *x -= along * d);
                }
            }
            let length = dot(&rest, &rest).sqrt();
            if length > self.tolerance * (kept.len() as f64 + 1.0).sqrt() {
                rest.iter_mut().for_each(|x| *x /= length);
                directions.push(rest);
                kept.push(j);
            }
        }
        // Where no column is near those before it, and yet all of them together are dependent (Kahan's triangles).
        loop {
            let matrix = |count: usize| kept[..count].iter().flat_map(|&j| column(j)).copied().collect();
            let first = first_deficient(kept.len(), |count| {
                let values = linalg::thin_svd(matrix(count), self.rank, count, pool)?.s;
                Ok(count <= self.rank && numerical_rank(&values, self.tolerance) == count)
            })?;
            match first {
                Some(count) => drop(kept.remove(count - 1)),
                None => return Ok(kept),
            }
        }
    }

    /// As many columns as the rank that span all columns, the largest remainder first.
    fn spanning_columns(&self) -> Vec<usize> {
        let rank = self.rank;
        let mut rest = self.triangle.clone();
        let mut kept = Vec::with_capacity(rank);
        for _ in 0..rank {
            let square = |j: usize| dot(&rest[j * rank..(j + 1) * rank], &rest[j * rank..(j + 1) * rank]);
            let next = (0..self.columns)
                .filter(|j| !kept.contains(j))
                .max_by(|&a, &b| square(a).total_cmp(&square(b)));
            let Some(next) = next else { break };
            let length = square(next).sqrt();
            let direction: Vec<f64> =
                rest[next * rank..(next + 1) * rank].iter().map(|x| x / length).collect();
            for column in rest.chunks_exact_mut(rank) {
                let along = dot(&direction, column);
                column.iter_mut().zip(&direction).for_each(|(x, d)| *x -= along * d);
            }
            kept.push(next);
        }
        kept.sort_unstable();
        kept
    }

    /// Takes `Q projection` from the residuals, and projects what is left.
    fn subtract(&mut self, projection: &[f64], pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        let (rank, responses) = (self.rank, self.responses);
        let size = rank * responses;
        if size == 0 {
            return Ok(Vec::new());
        }
        let mut parts = vec![0.0; self.residuals.len().div_ceil(LEAF_ROWS * responses) * size];
        let residuals = self.residuals.chunks_mut(LEAF_ROWS * responses);
        pool.run(
            residuals.zip(self.basis.chunks(LEAF_ROWS * rank)).zip(parts.chunks_exact_mut(size)),
            || (),
            |(), ((residuals, basis), part)| {
                for (e, q) in residuals.chunks_exact_mut(responses).zip(basis.chunks_exact(rank)) {
                    for (e, c) in e.iter_mut().zip(projection.chunks_exact(rank)) {
                        *e -= dot(q, c);
                    }
                }
                linalg::transposed_product(basis, residuals, rank, responses, part);
            },
        )?;
        Ok(sum_of_parts(&parts, size))
    }

    /// Squared lengths of the basis' rows that are A's.
    fn squared_lengths(&self, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        let mut squares = vec![0.0; self.rows];
        if self.rank > 0 {
            let parts = squares.chunks_mut(LEAF_ROWS).zip(self.basis.chunks(LEAF_ROWS * self.rank));
            pool.run(
                parts,
                || (),
                |(), (squares, basis)| {
                    for (square, q) in squares.iter_mut().zip(basis.chunks_exact(self.rank)) {
                        *square = dot(q, q);
                    }
                },
            )?;
        }
        Ok(squares)
    }
}

/// Sums that blocks have begun, put together in order.
fn sum_of_parts(parts: &[f64], size: usize) -> Vec<f64> {
    let mut sum = vec![0.0; size];
    for part in parts.chunks_exact(size) {
        sum.iter_mut().zip(part).for_each(|(s, x)| *s += x);
    }
    sum
}

pub(crate) fn expect_length(given: usize, expected: usize) -> Result<(), Error> {
    if given == expected { Ok(()) } else { Err(Error::Length { expected, given }) }
}

/// Rows of a block: what is done with it twice finds it in the cache the second time.
const LEAF_ROWS: usize = 512;

/// Powers of two that bring every column's largest entry near one: overflow is then out of the way, and not a
/// digit changes.
fn column_scales(problem: &Problem<'_>, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
    let columns = problem.columns;
    let blocks =
        problem.design.chunks(LEAF_ROWS * columns).chain(problem.penalty.chunks(LEAF_ROWS * columns));
    let blocks: Vec<&[f64]> = blocks.collect();
    let mut largest = vec![0.0_f64; blocks.len() * columns];
    pool.run(
        blocks.iter().zip(largest.chunks_exact_mut(columns)),
        || (),
        |(), (block, largest)| {
            for row in block.chunks_exact(columns) {
                for (largest, a) in largest.iter_mut().zip(row) {
                    // One instruction for several, which `max` is not.
                    *largest = if a.abs() > *largest { a.abs() } else { *largest };
                }
            }
        },
    )?;
    Ok((0..columns)
        .map(|j| largest.iter().skip(j).step_by(columns).fold(0.0_f64, |a, &b| a.max(b)))
        .map(
            |largest| {
                if largest > 0.0 { (-largest.log2().ceil().clamp(-1000.0, 1000.0)).exp2() } else { 1.0 }
            },
        )
        .collect())
}

/// `[W^1/2 b; 0]`.
pub(crate) fn weighted_responses(problem: &Problem<'_>, responses: usize) -> Vec<f64> {
    let mut b = problem.responses.to_vec();
    b.resize(problem.total_rows() * responses, 0.0);
    if let (Some(weights), true) = (problem.root_weights, responses > 0) {
        for (row, w) in b.chunks_exact_mut(responses).zip(weights) {
            row.iter_mut().for_each(|x| *x *= w);
        }
    }
    b
}
