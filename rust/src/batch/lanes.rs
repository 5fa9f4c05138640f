//! Fits of problems of one shape side by side, each in a lane of the vectors: an instruction serves all of them.
//!
//! Small matrices leave vectors half empty and processors waiting for one number after another. Lanes never do: the
//! algorithms are the plain ones, of numbers that are vectors. What a problem comes to does not depend on its neighbours,
//! nor on the width of the vectors.

use pulp::{Simd, bytemuck};

use crate::fit::factor::Problem;
use crate::fit::lead::WORTH;

/// Of how many rows, columns and responses each problem is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    pub rows: usize,
    pub columns: usize,
    pub responses: usize,
}

/// Columns whose products with a vector are summed together, so that sums need not wait for each other.
const TOGETHER: usize = 4;

/// Lanes of the widest vectors.
const WIDEST: usize = 8;

/// Squared lengths of columns between which nothing here over- or underflows.
const SAFE: [f64; 2] = [1e-200, 1e200];

/// How many times longer than another a row may be, with columns at unit length: reflections that do not sort rows lose
/// digits of short ones.
const LONGER: f64 = 1e4;

/// The sum of the squares of `R^-1`, with columns of A at unit length, up to which a problem is far from rank loss.
const FAR: f64 = 1e14;

/// By lane, a column and its multiple; zero where the problem has no lead.
type Leads = [(usize, f64); WIDEST];

/// The fits of problems side by side. Matrices are column-major.
pub(super) struct Fits<'a, S: Simd> {
    pub shape: Shape,
    /// The design, then its orthonormal basis Q, rows x columns.
    pub basis: &'a mut [S::f64s],
    /// The responses, then their residuals, rows x responses.
    pub residuals: &'a mut [S::f64s],
    /// `Q^T b`, then x, columns x responses.
    pub coefficients: &'a mut [S::f64s],
    /// R, then its inverse, columns x columns.
    triangle: &'a mut [S::f64s],
    /// Squared lengths of the columns.
    lengths: &'a mut [S::f64s],
    /// Squared lengths of the responses.
    sizes: &'a mut [S::f64s],
    /// Of the reflections `I - v s v^T`, whose vectors v are in the basis first, the numbers s.
    shares: &'a mut [S::f64s],
}

impl Shape {
    /// Vectors that the fits take.
    pub fn vectors(self) -> usize {
        let Self { rows, columns, responses } = self;
        (rows + columns) * (columns + responses) + 2 * columns + responses
    }

    /// Puts the weighted rows of problems into lanes; spare lanes repeat the last problem.
    #[inline(always)]
    pub fn load(self, problems: &[Problem<'_>], width: usize, space: &mut [f64]) {
        let Self { rows, columns, responses } = self;
        let of_lane: [&Problem<'_>; WIDEST] = std::array::from_fn(|lane| of_lane(problems, lane));
        let (basis, space) = space.split_at_mut(rows * columns * width);
        for i in 0..rows {
            let roots = of_lane.map(|problem| problem.root_weights.map_or(1.0, |roots| roots[i]));
            let design = of_lane.map(|problem| &problem.design[i * columns..(i + 1) * columns]);
            let b = of_lane.map(|problem| &problem.responses[i * responses..(i + 1) * responses]);
            spread(basis, (rows, i, width), design, roots);
            spread(space, (rows, i, width), b, roots);
        }
    }
}

/// The problem of a lane; spare ones repeat the last.
#[inline(always)]
fn of_lane<'a, 'b>(problems: &'a [Problem<'b>], lane: usize) -> &'a Problem<'b> {
    &problems[lane.min(problems.len() - 1)]
}

/// Puts weighted row i of the matrices of several problems into a matrix of lanes.
#[inline(always)]
fn spread(
    matrix: &mut [f64],
    (rows, i, width): (usize, usize, usize),
    sources: [&[f64]; WIDEST],
    roots: [f64; WIDEST],
) {
    for (lane, (source, root)) in sources.into_iter().zip(roots).take(width).enumerate() {
        for (x, a) in matrix[i * width + lane..].iter_mut().step_by(rows * width).zip(source) {
            *x = a * root;
        }
    }
}

impl<'a, S: Simd> Fits<'a, S> {
    /// Fits problems that `load` has put into the space. A fit is of use only where it is `far` from rank loss, overflow
    /// and underflow.
    #[inline(always)]
    pub fn new(simd: S, shape: Shape, problems: &[Problem<'_>], space: &'a mut [S::f64s]) -> (Self, S::m64s) {
        let Shape { rows, columns, responses } = shape;
        let (basis, space) = space.split_at_mut(rows * columns);
        let (residuals, space) = space.split_at_mut(rows * responses);
        let (coefficients, space) = space.split_at_mut(columns * responses);
        let (triangle, space) = space.split_at_mut(columns * columns);
        let (lengths, space) = space.split_at_mut(columns);
        let (shares, space) = space.split_at_mut(columns);
        let sizes = &mut space[..responses];
        let mut fits = Self { shape, basis, residuals, coefficients, triangle, lengths, sizes, shares };
        let safe = fits.measure(simd);
        fits.reflect(simd);
        fits.gather(simd);
        fits.project(simd);
        let leads = fits.leads(simd);
        if !leads.is_empty() {
            fits.take(problems, &leads);
            fits.project(simd);
        }
        let far = fits.invert(simd);
        fits.solve(simd);
        fits.give_back(&leads);
        (fits, simd.and_m64s(safe, far))
    }

    /// Lengths of the columns, and whether squares of all numbers are in range, and rows of similar length.
    #[inline(always)]
    fn measure(&mut self, simd: S) -> S::m64s {
        let [least, most] = SAFE.map(|bound| simd.splat_f64s(bound));
        let mut safe = simd.less_than_f64s(least, most);
        for (column, length) in self.basis.chunks_exact(self.shape.rows).zip(self.lengths.iter_mut()) {
            *length = dot(simd, column, column);
            safe = simd.and_m64s(safe, within(simd, least, *length, most));
        }
        for (column, size) in self.residuals.chunks_exact(self.shape.rows).zip(self.sizes.iter_mut()) {
            *size = dot(simd, column, column);
            safe = simd.and_m64s(safe, within(simd, least, *size, most));
        }
        for (unit, length) in self.shares.iter_mut().zip(self.lengths.iter()) {
            *unit = simd.div_f64s(simd.splat_f64s(1.0), *length);
        }
        let [mut shortest, mut longest] = [f64::MAX, 0.0].map(|length| simd.splat_f64s(length));
        let zero = simd.splat_f64s(0.0);
        for i in 0..self.shape.rows {
            let row = self.basis.iter().skip(i).step_by(self.shape.rows).zip(self.shares.iter());
            let share =
                |sum, (x, unit): (&S::f64s, &S::f64s)| simd.mul_add_f64s(simd.mul_f64s(*x, *unit), *x, sum);
            let square = row.fold(zero, share);
            // Rows of zeros have no digits.
            let positive = simd.less_than_f64s(zero, square);
            let shorter = simd.and_m64s(positive, simd.less_than_f64s(square, shortest));
            shortest = simd.select_f64s(shorter, square, shortest);
            longest = simd.select_f64s(simd.less_than_f64s(longest, square), square, longest);
        }
        let bound = simd.mul_f64s(shortest, simd.splat_f64s(LONGER * LONGER));
        simd.and_m64s(safe, simd.less_than_f64s(longest, bound))
    }

    /// Householder's reflections: R, and their vectors in place of the design.
    #[inline(always)]
    fn reflect(&mut self, simd: S) {
        let Shape { rows, columns, .. } = self.shape;
        let zero = simd.splat_f64s(0.0);
        for j in 0..columns {
            let (left, right) = self.basis.split_at_mut((j + 1) * rows);
            let (above, vector) = left[j * rows..].split_at_mut(j);
            let length = simd.sqrt_f64s(dot(simd, vector, vector));
            let negative = simd.less_than_f64s(vector[0], zero);
            let diagonal = simd.select_f64s(negative, length, simd.neg_f64s(length));
            let entries = &mut self.triangle[j * columns..=j * columns + j];
            entries[..j].copy_from_slice(above);
            entries[j] = diagonal;
            above.fill(zero);
            vector[0] = simd.sub_f64s(vector[0], diagonal);
            // Half of v^T v is |x| (|x| + |x_0|), whatever the sign.
            let half = simd.neg_f64s(simd.mul_f64s(diagonal, vector[0]));
            self.shares[j] = simd.div_f64s(simd.splat_f64s(1.0), half);
            reflect(simd, vector, self.shares[j], right, (rows, j));
        }
    }

    /// Q in place of the vectors of the reflections: those of the leading columns of the identity.
    #[inline(always)]
    fn gather(&mut self, simd: S) {
        let Shape { rows, columns, .. } = self.shape;
        for j in (0..columns).rev() {
            let (left, right) = self.basis.split_at_mut((j + 1) * rows);
            let vector = &mut left[j * rows + j..];
            reflect(simd, vector, self.shares[j], right, (rows, j));
            let share = simd.neg_f64s(simd.mul_f64s(vector[0], self.shares[j]));
            vector.iter_mut().for_each(|x| *x = simd.mul_f64s(*x, share));
            vector[0] = simd.add_f64s(vector[0], simd.splat_f64s(1.0));
        }
    }

    /// Residuals and `Q^T b`. What rounding of the responses leaves along Q is taken by a second pass.
    #[inline(always)]
    fn project(&mut self, simd: S) {
        let Shape { rows, columns, .. } = self.shape;
        self.coefficients.fill(simd.splat_f64s(0.0));
        let responses =
            self.residuals.chunks_exact_mut(rows).zip(self.coefficients.chunks_exact_mut(columns));
        for (b, known) in responses {
            for _ in 0..2 {
                let mut done = 0;
                for group in self.basis.chunks(TOGETHER * rows) {
                    let along = products(simd, b, group, rows);
                    for (q, along) in group.chunks_exact(rows).zip(along) {
                        add(simd, b, simd.neg_f64s(along), q);
                        known[done] = simd.add_f64s(known[done], along);
                        done += 1;
                    }
                }
            }
        }
    }

    /// Of each response, the columns that take most of it, as in `fit::lead`; nothing where that is worth it in no lane.
    #[inline(always)]
    fn leads(&self, simd: S) -> Vec<Leads> {
        let (columns, [zero, worth]) = (self.shape.columns, [0.0, WORTH].map(|x| simd.splat_f64s(x)));
        let mut leads = Vec::new();
        for (c, known) in self.coefficients.chunks_exact(columns).enumerate() {
            let (mut most, mut column, mut multiple) = (zero, zero, zero);
            for (j, (r, length)) in self.triangle.chunks_exact(columns).zip(self.lengths.iter()).enumerate() {
                let along = dot(simd, &r[..=j], known);
                let share = simd.div_f64s(along, *length);
                let square = simd.mul_f64s(share, along);
                let more = simd.less_than_f64s(most, square);
                most = simd.select_f64s(more, square, most);
                column = simd.select_f64s(more, simd.splat_f64s(j as f64), column);
                multiple = simd.select_f64s(more, share, multiple);
            }
            let worth = simd.less_than_f64s(self.sizes[c], simd.mul_f64s(most, worth));
            if simd.first_true_m64s(worth) < S::F64_LANES {
                leads.resize(self.shape.responses, [(0, 0.0); WIDEST]);
                let found = [column, simd.select_f64s(worth, multiple, zero)];
                let (columns, multiples) =
                    bytemuck::cast_slice::<S::f64s, f64>(&found).split_at(S::F64_LANES);
                for (lead, (j, multiple)) in leads[c].iter_mut().zip(columns.iter().zip(multiples)) {
                    *lead = (*j as usize, *multiple);
                }
            }
        }
        leads
    }

    /// The responses again, without these multiples of columns.
    #[inline(always)]
    fn take(&mut self, problems: &[Problem<'_>], leads: &[Leads]) {
        let Shape { rows, columns, responses } = self.shape;
        for (c, (left, leads)) in self.residuals.chunks_exact_mut(rows).zip(leads).enumerate() {
            let left = bytemuck::cast_slice_mut::<S::f64s, f64>(left);
            for (lane, &(j, multiple)) in leads.iter().enumerate().take(S::F64_LANES) {
                let problem = of_lane(problems, lane);
                for (i, left) in left[lane..].iter_mut().step_by(S::F64_LANES).enumerate() {
                    let (b, a) = (problem.responses[i * responses + c], problem.design[i * columns + j]);
                    let root = problem.root_weights.map_or(1.0, |roots| roots[i]);
                    *left = root * if multiple == 0.0 { b } else { a.mul_add(-multiple, b) };
                }
            }
        }
    }

    /// `R^-1` in place of R, and whether the design is far from rank loss.
    #[inline(always)]
    fn invert(&mut self, simd: S) -> S::m64s {
        let columns = self.shape.columns;
        let mut squares = simd.splat_f64s(0.0);
        for j in 0..columns {
            let (done, column) = self.triangle.split_at_mut(j * columns);
            let inverse = simd.div_f64s(simd.splat_f64s(1.0), column[j]);
            column[j] = simd.neg_f64s(simd.splat_f64s(1.0));
            for i in 0..=j {
                let mut sum = if i == j { column[j] } else { simd.splat_f64s(0.0) };
                for k in i..j {
                    sum = simd.mul_add_f64s(done[k * columns + i], column[k], sum);
                }
                column[i] = simd.neg_f64s(simd.mul_f64s(sum, inverse));
                let square = simd.mul_f64s(column[i], column[i]);
                squares = simd.mul_add_f64s(square, self.lengths[i], squares);
            }
        }
        simd.less_than_f64s(squares, simd.splat_f64s(FAR))
    }

    /// `x = R^-1 Q^T b`.
    #[inline(always)]
    fn solve(&mut self, simd: S) {
        let columns = self.shape.columns;
        for x in self.coefficients.chunks_exact_mut(columns) {
            for i in 0..columns {
                let mut sum = simd.splat_f64s(0.0);
                for (k, x) in x.iter().enumerate().skip(i) {
                    sum = simd.mul_add_f64s(self.triangle[k * columns + i], *x, sum);
                }
                x[i] = sum;
            }
        }
    }

    /// Adds the multiples of columns that were taken to x.
    #[inline(always)]
    fn give_back(&mut self, leads: &[Leads]) {
        for (x, leads) in self.coefficients.chunks_exact_mut(self.shape.columns).zip(leads) {
            let x = bytemuck::cast_slice_mut::<S::f64s, f64>(x);
            for (lane, &(j, multiple)) in leads.iter().enumerate().take(S::F64_LANES) {
                // Adding zero would take the sign of another.
                if multiple != 0.0 {
                    x[j * S::F64_LANES + lane] += multiple;
                }
            }
        }
    }
}

/// `I - v s v^T` applied to columns of so many rows, of which the first ones stay.
#[inline(always)]
fn reflect<S: Simd>(
    simd: S,
    vector: &[S::f64s],
    share: S::f64s,
    targets: &mut [S::f64s],
    (rows, first): (usize, usize),
) {
    let negative = simd.neg_f64s(share);
    for group in targets.chunks_mut(TOGETHER * rows) {
        let along = products(simd, vector, &group[first..], rows);
        for (target, along) in group.chunks_exact_mut(rows).zip(along) {
            add(simd, &mut target[first..], simd.mul_f64s(along, negative), vector);
        }
    }
}

/// Whether `least < x < most`: not if x is no number.
#[inline(always)]
fn within<S: Simd>(simd: S, least: S::f64s, x: S::f64s, most: S::f64s) -> S::m64s {
    simd.and_m64s(simd.less_than_f64s(least, x), simd.less_than_f64s(x, most))
}

/// Products of a vector with up to four others, the starts of which are `stride` apart.
#[inline(always)]
fn products<S: Simd>(simd: S, vector: &[S::f64s], others: &[S::f64s], stride: usize) -> [S::f64s; TOGETHER] {
    let mut sums = [simd.splat_f64s(0.0); TOGETHER];
    if others.len() > (TOGETHER - 1) * stride {
        let others: [&[S::f64s]; TOGETHER] =
            std::array::from_fn(|k| &others[k * stride..k * stride + vector.len()]);
        for (i, x) in vector.iter().enumerate() {
            for k in 0..TOGETHER {
                sums[k] = simd.mul_add_f64s(*x, others[k][i], sums[k]);
            }
        }
    } else {
        for (other, sum) in others.chunks(stride).zip(&mut sums) {
            *sum = dot(simd, vector, other);
        }
    }
    sums
}

/// Sum of products of the numbers of two vectors, as many as the shorter has, in four running sums.
#[inline(always)]
pub(super) fn dot<S: Simd>(simd: S, a: &[S::f64s], b: &[S::f64s]) -> S::f64s {
    let mut sums = [simd.splat_f64s(0.0); TOGETHER];
    let count = a.len().min(b.len());
    let ((a, a_end), (b, b_end)) = (a[..count].as_chunks::<TOGETHER>(), b[..count].as_chunks::<TOGETHER>());
    for (a, b) in a.iter().zip(b) {
        for k in 0..TOGETHER {
            sums[k] = simd.mul_add_f64s(a[k], b[k], sums[k]);
        }
    }
    for ((a, b), sum) in a_end.iter().zip(b_end).zip(&mut sums) {
        *sum = simd.mul_add_f64s(*a, *b, *sum);
    }
    simd.add_f64s(simd.add_f64s(sums[0], sums[1]), simd.add_f64s(sums[2], sums[3]))
}

/// Adds a multiple of a vector to another.
#[inline(always)]
pub(super) fn add<S: Simd>(simd: S, target: &mut [S::f64s], factor: S::f64s, vector: &[S::f64s]) {
    for (t, x) in target.iter_mut().zip(vector) {
        *t = simd.mul_add_f64s(*x, factor, *t);
    }
}
