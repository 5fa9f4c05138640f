//! The design's orthonormal basis, and what one fit tells: rank, coefficients, residuals, leverage.
//!
//! The basis is that of `fit::cholesky_qr`, or of `fit::householder` where the first would lose digits. Work is
//! cut into blocks of rows that depend on the shape alone, never on the number of threads.

use crate::error::Error;
use crate::fit::lead::Lead;
use crate::fit::linalg::{self, dot};
use crate::fit::rank::{Spectrum, first_deficient, numerical_rank};
use crate::fit::residuals::Residuals;
use crate::fit::survey::Survey;
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
    pub(crate) fn total_rows(&self) -> usize {
        self.rows + self.penalty.len().checked_div(self.columns).unwrap_or(0)
    }

    /// Responses of row `i`; none of a penalty row.
    pub(super) fn responses_of(&self, i: usize, count: usize) -> &[f64] {
        self.responses.get(i * count..(i + 1) * count).unwrap_or_default()
    }

    pub(super) fn check(&self) -> Result<usize, Error> {
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
    coordinates: Coordinates,
    /// What each row of the problem was, to notice that it has changed.
    fingerprints: Vec<u64>,
    /// Weighted residuals, rows x responses, row-major; those of the penalty rows, `0 - Z x`, last.
    pub(crate) residuals: Vec<f64>,
    /// `Q^T b` of the weighted responses, responses x rank.
    pub(crate) projection: Vec<f64>,
    /// The largest of each weighted response.
    largest: Vec<f64>,
    /// Diagonal of the hat matrix.
    pub leverage: Vec<f64>,
    /// Square roots of the weights.
    pub(crate) root_weights: Option<Vec<f64>>,
}

/// Above this lambda_min(M) predictions would have to be thousands of times as large as the responses to lose nine digits.
const OUTGROWING: f64 = 1e-3;

/// Coordinates in which the rows of a problem have full rank.
enum Coordinates {
    /// Those of all columns; of more than the rank, if the penalty alone sees some directions.
    Columns,
    /// Those of columns that span them all, where some depend on the others.
    Spanning(Vec<usize>),
    /// Those of the basis, where it is narrower than the columns.
    Basis,
}

/// An orthonormal basis of a design's columns.
pub(super) struct Basis {
    /// Row by row, as wide as the rank.
    pub rows: Vec<f64>,
    /// What their triangle tells.
    pub spectrum: Spectrum,
    /// What it takes from the weighted responses, and leaves.
    pub residuals: Residuals,
}

impl Basis {
    /// Of the columns of a problem, scaled; the rank is that of so many rows.
    pub fn new(
        problem: &Problem<'_>,
        scales: &[f64],
        counted: usize,
        pool: &Pool<'_>,
    ) -> Result<Self, Error> {
        if let Some(basis) = cholesky_qr::orthonormal(problem, scales, counted, pool)? {
            return Ok(basis);
        }
        let (rows, spectrum) = householder::orthonormal(problem, scales, counted, pool)?;
        let responses = problem.responses.len() / problem.rows;
        let weighted = (weighted_responses(problem, responses), responses);
        let basis = (&rows[..], spectrum.rank);
        let projection = Residuals::projection(weighted, basis, pool)?;
        let lead = Lead::new(problem, &spectrum, scales, projection.clone());
        let left = (lead.left(problem, pool)?, responses);
        let residuals = Residuals::new(left, basis, (&lead.projection, projection), pool)?;
        Ok(Self { rows, spectrum, residuals })
    }
}

impl Factor {
    /// Factors and fits.
    pub fn new(problem: &Problem<'_>, pool: &Pool<'_>) -> Result<Self, Error> {
        Self::standing_for(problem, problem.total_rows(), pool)
    }

    /// Factors and fits rows that stand for more, as a triangle does: the rounding of all of them decides the rank.
    pub fn standing_for(problem: &Problem<'_>, counted: usize, pool: &Pool<'_>) -> Result<Self, Error> {
        let responses = problem.check()?;
        let Survey { scales, fingerprints } = Survey::new(problem, pool)?;
        let Basis { rows, spectrum, residuals } = Basis::new(problem, &scales, counted, pool)?;
        let mut factor = Self::fitted(problem, (rows, spectrum.rank), residuals, fingerprints);
        factor.coefficients = spectrum.solve(&factor.projection, responses);
        for column in factor.coefficients.chunks_exact_mut(problem.columns) {
            column.iter_mut().zip(&scales).for_each(|(x, s)| *x *= s);
        }
        factor.least = spectrum.least;
        factor.tolerance = spectrum.tolerance;
        factor.triangle = spectrum.triangle;
        factor.scales = spectrum.scales.iter().zip(&scales).map(|(unit, power)| unit * power).collect();
        if factor.rank < factor.columns {
            factor.coordinates = Coordinates::Spanning(factor.spanning_columns());
        }
        Ok(factor)
    }

    /// Fits a problem of which a basis, `rank` wide, and the responses' projection are known: its coefficients are those of
    /// the basis. A basis is orthonormal to rounding, which rows of zeros lose: pairs close to rank loss go back to the
    /// problem's columns, if there are scales that bring them to unit length, else to the basis.
    pub(super) fn orthonormal(
        problem: &Problem<'_>,
        (basis, rank): (Vec<f64>, usize),
        projection: Vec<f64>,
        scales: Option<Vec<f64>>,
        fingerprints: Vec<u64>,
        pool: &Pool<'_>,
    ) -> Result<Self, Error> {
        let responses = problem.responses.len() / problem.rows;
        let mut weighted = weighted_responses(problem, responses);
        weighted.resize(basis.len().checked_div(rank).unwrap_or(problem.total_rows()) * responses, 0.0);
        let residuals =
            Residuals::new((weighted, responses), (&basis, rank), (&projection.clone(), projection), pool)?;
        let mut factor = Self::fitted(problem, (basis, rank), residuals, fingerprints);
        factor.columns = rank;
        factor.coefficients.clone_from(&factor.projection);
        factor.least = 1.0;
        factor.tolerance = factor.total_rows.max(rank) as f64 * f64::EPSILON;
        match scales {
            Some(scales) => factor.scales = scales,
            None => factor.coordinates = Coordinates::Basis,
        }
        Ok(factor)
    }

    /// Of a basis and what it leaves of the responses, without coefficients.
    fn fitted(
        problem: &Problem<'_>,
        (basis, rank): (Vec<f64>, usize),
        residuals: Residuals,
        fingerprints: Vec<u64>,
    ) -> Self {
        let Problem { rows, columns, .. } = *problem;
        let Residuals { left, projection, mut leverage } = residuals;
        leverage.resize(rows, 0.0);
        let responses = problem.responses.len() / rows;
        let mut largest = vec![0.0; responses];
        for i in 0..rows {
            let root = problem.root_weights.map_or(1.0, |roots| roots[i]);
            for (most, b) in largest.iter_mut().zip(problem.responses_of(i, responses)) {
                *most = f64::max(*most, (b * root).abs());
            }
        }
        Self {
            rows,
            columns,
            responses,
            rank,
            total_rows: basis.len().checked_div(rank).unwrap_or(problem.total_rows()),
            basis,
            triangle: Vec::new(),
            least: 0.0,
            tolerance: 0.0,
            scales: Vec::new(),
            coefficients: Vec::new(),
            coordinates: Coordinates::Columns,
            fingerprints,
            residuals: left,
            leverage,
            projection,
            largest,
            root_weights: problem.root_weights.map(<[f64]>::to_vec),
        }
    }

    /// The lambda_min(M) from which the closed form holds, M of a pair being `I - Q_K^T Q_K`: its error is about
    /// eps / lambda_min(M), of which nine digits are left at 2e-6. The training rows' least singular value is at least that
    /// of all rows times the root of lambda_min(M), so the rank of a design near rank loss asks for more. Estimates of
    /// lambda_min(M) may be ten times too large.
    pub(crate) fn closed_form_least(&self) -> f64 {
        f64::max(2e-6, self.certain_least())
    }

    /// Whether weighted predictions of the closed form, of a pair with this lambda_min(M), are so much larger than the
    /// responses that nine digits of these are not left.
    pub(crate) fn outgrown(&self, predictions: &[f64], least: f64) -> bool {
        if least > OUTGROWING {
            return false;
        }
        let bound = 1e-9 / f64::EPSILON * least;
        let mut rows = predictions.chunks_exact(self.responses.max(1));
        rows.any(|row| row.iter().zip(&self.largest).any(|(e, largest)| e.abs() > bound * largest))
    }

    /// Above this estimate of lambda_min(M) training rows have the rank of the design.
    pub(crate) fn certain_least(&self) -> f64 {
        let beyond_doubt = 2.0 * self.tolerance * (self.columns as f64).sqrt() / self.least;
        if self.rank == 0 { 0.0 } else { 10.0 * beyond_doubt * beyond_doubt }
    }

    /// Row `i` of the basis.
    pub fn basis_row(&self, i: usize) -> &[f64] {
        &self.basis[i * self.rank..(i + 1) * self.rank]
    }

    /// Weighted residuals of row `i`.
    pub(crate) fn residual_row(&self, i: usize) -> &[f64] {
        &self.residuals[i * self.responses..(i + 1) * self.responses]
    }

    /// How many coordinates a row has in `full_rank_row`.
    pub(crate) fn coordinates(&self) -> usize {
        match self.coordinates {
            Coordinates::Columns => self.scales.len(),
            _ => self.rank,
        }
    }

    /// Row `i` of the problem in coordinates in which it has full rank, then its right-hand side. Those of A are the
    /// best: the basis is good to rounding of the largest entries only, which small training rows feel.
    pub(crate) fn full_rank_row(
        &self,
        problem: &Problem<'_>,
        i: usize,
        out: &mut [f64],
    ) -> Result<(), Error> {
        if self.fingerprints.get(i).is_some_and(|&print| print != problem.fingerprint(i, self.responses)) {
            return Err(Error::Changed { row: i });
        }
        let (left, right) = out.split_at_mut(self.coordinates());
        match &self.coordinates {
            Coordinates::Columns => {
                let (row, weight) = problem.row(i);
                for ((x, a), scale) in left.iter_mut().zip(row).zip(&self.scales) {
                    *x = a * scale * weight;
                }
            }
            Coordinates::Spanning(columns) => {
                let (row, weight) = problem.row(i);
                for (x, &j) in left.iter_mut().zip(columns) {
                    *x = row[j] * self.scales[j] * weight;
                }
            }
            Coordinates::Basis => left.copy_from_slice(self.basis_row(i)),
        }
        right.fill(0.0);
        for (x, b) in right.iter_mut().zip(problem.responses_of(i, self.responses)) {
            *x = b * problem.root_weights.map_or(1.0, |w| w[i]);
        }
        Ok(())
    }

    /// Rows of the problem that pairs close to rank loss go back to.
    pub(crate) fn problem_rows(&self) -> usize {
        match self.coordinates {
            Coordinates::Basis => self.total_rows,
            _ => self.fingerprints.len(),
        }
    }

    /// What brings row `i` back from weighted to plain units.
    pub(crate) fn unweight(&self, i: usize) -> f64 {
        self.root_weights.as_ref().map_or(1.0, |w| w[i].recip())
    }

    /// Residuals in the responses' unit, rows x responses, row-major.
    pub fn plain_residuals(&self) -> Vec<f64> {
        (0..self.rows).flat_map(|i| self.residual_row(i).iter().map(move |e| e * self.unweight(i))).collect()
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
}

pub(crate) fn expect_length(given: usize, expected: usize) -> Result<(), Error> {
    if given == expected { Ok(()) } else { Err(Error::Length { expected, given }) }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Example, assert_close, bits, pool};

    #[test]
    fn a_fit_is_the_plain_one() {
        let example = Example::new(40, 6, 2);
        let factor = example.factor();
        let rows: Vec<usize> = (0..40).collect();
        let expected = example.refit(&[], &rows);
        assert_close(&factor.plain_residuals(), &expected, 1e-14);
        let fitted = |i: usize, c: usize| {
            dot(&example.design[6 * i..6 * i + 6], &factor.coefficients[6 * c..6 * c + 6])
        };
        let residuals: Vec<f64> = (0..80).map(|k| example.responses[k] - fitted(k / 2, k % 2)).collect();
        assert_close(&residuals, &expected, 1e-14);
        let leverage: Vec<f64> =
            rows.iter().map(|&i| dot(factor.basis_row(i), factor.basis_row(i))).collect();
        assert_close(&factor.leverage, &leverage, 1e-14);
        // Q^T e = 0, penalty rows included; and Q^T b is the projection.
        for j in 0..6 {
            let along = |i: usize| factor.basis[6 * i + j] * factor.residuals[2 * i];
            assert!((0..42).map(along).sum::<f64>().abs() < 1e-14);
            let weighted = |i: usize| example.responses[2 * i + 1] * example.root_weights[i];
            let projection: f64 = (0..40).map(|i| factor.basis[6 * i + j] * weighted(i)).sum();
            assert!((factor.projection[6 + j] - projection).abs() < 1e-13);
        }
    }

    /// Dependent columns: the shortest solution, the columns that are independent, and those that span.
    #[test]
    fn columns_that_depend_on_others_lower_the_rank() {
        let mut example = Example::new(30, 5, 1);
        example.penalty.clear();
        example.design.chunks_exact_mut(5).for_each(|row| (row[1], row[3]) = (2.0 * row[0], row[0] - row[2]));
        let factor = example.factor();
        assert_eq!(factor.rank, 3);
        assert_eq!(factor.independent_columns(&pool(1)), Ok(vec![0, 2, 4]));
        assert_eq!(factor.spanning_columns().len(), 3);
        let mut kept = example.clone();
        kept.columns = 3;
        kept.design = example.design.chunks(5).flat_map(|row| [row[0], row[2], row[4]]).collect();
        assert_close(&factor.plain_residuals(), &kept.factor().plain_residuals(), 1e-13);
        assert_eq!(factor.problem_rows(), 30);
        // In the coordinates of columns that span, a row is finite and of full rank: three rows are independent.
        let mut row = [0.0; 4];
        factor.full_rank_row(&example.problem(), 7, &mut row).unwrap();
        assert_eq!(row[3], example.responses[7] * example.root_weights[7]);
    }

    /// A column that is nearly another's copy: training rows that see a fraction of the rest may not see it at all.
    #[test]
    fn the_nearer_a_design_is_to_rank_loss_the_less_is_certain() {
        let mut example = Example::new(30, 4, 1);
        let factor = example.factor();
        assert!(factor.certain_least() < 1e-20 && factor.closed_form_least() == 2e-6);
        for matrix in [&mut example.design, &mut example.penalty] {
            matrix.chunks_exact_mut(4).for_each(|row| row[3] = row[1] + 1e-12 * row[3]);
        }
        let factor = example.factor();
        assert!((1e-5..10.0).contains(&factor.certain_least()));
        assert_eq!(factor.closed_form_least(), factor.certain_least());
        example.design.fill(0.0);
        example.penalty.fill(0.0);
        assert_eq!(example.factor().certain_least(), 0.0);
    }

    /// Columns that differ by the rounding of many rows are one.
    #[test]
    fn the_more_rows_a_triangle_stands_for_the_more_is_rounding() {
        let mut example = Example::new(30, 4, 1);
        for matrix in [&mut example.design, &mut example.penalty] {
            matrix.chunks_exact_mut(4).for_each(|row| row[3] = row[1] + 1e-12 * row[3]);
        }
        let rank = |counted| Factor::standing_for(&example.problem(), counted, &pool(1)).unwrap().rank;
        assert_eq!((example.factor().rank, rank(32), rank(1_000_000)), (4, 4, 3));
    }

    /// Powers of two, so that no digit changes.
    #[test]
    fn units_of_columns_change_no_digit() {
        let example = Example::new(30, 4, 1);
        let mut scaled = example.clone();
        let powers = [0, 40, -300, 7].map(|power| f64::from(power).exp2());
        for matrix in [&mut scaled.design, &mut scaled.penalty] {
            matrix.chunks_exact_mut(4).for_each(|row| row.iter_mut().zip(powers).for_each(|(x, s)| *x *= s));
        }
        let (one, other) = (example.factor(), scaled.factor());
        assert_eq!(bits(&one.basis), bits(&other.basis));
        assert_eq!(bits(&one.residuals), bits(&other.residuals));
        let coefficients: Vec<f64> = other.coefficients.iter().zip(powers).map(|(x, s)| x * s).collect();
        assert_close(&coefficients, &one.coefficients, 1e-14);
    }
}
