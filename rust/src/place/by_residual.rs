//! Residual-driven placement: control points arrive one at a time, each where the fit is worst.
//!
//! Thin-plate splines on the first l control points are nested: control point k > 3 adds one function, `phi(|q - c_k|)`
//! minus its barycentric combination of the first three, `phi(r) = r^2 log r`. What it adds to an orthonormal basis Q of
//! the functions before it, at the data, is one column: O(n l) a step, where a refit would take O(n l^2).
//!
//! * **Orthogonal twice.** One step of Gram-Schmidt leaves rounding of the whole column in what may be a small remainder;
//!   a second one removes it. It needs the remainder's products with Q, taken while the first step has a block of Q in
//!   cache; and since they are tiny, the residuals are known without it, so that it can wait until the next column needs
//!   that block. Q is read from memory twice a step, not four times.
//! * **Blocks of rows.** Columns are cut into blocks of a fixed number of rows, one after another in each: both `Q^T q` and
//!   `q - Q h` stream. Sums go from block to block in order, so that threads do not matter.
//! * **Ties.** Residuals that differ by rounding are equal, and the first datum comes first: on gridded data, where ties are
//!   the rule, the choice does not depend on the processor either.

use std::array;

use pulp::{Arch, Simd, WithSimd};

use crate::error::Error;
use crate::near::neighbours::unit_scale;
use crate::pool::Pool;

/// Rows of a block: a block of two hundred columns stays in the cache of a core.
const BLOCK_ROWS: usize = 512;

/// Columns multiplied at a time, so that sums do not wait for each other.
const COLUMNS: usize = 8;

/// Multiply-adds a task should be worth: waking a thread costs about as much as a tenth of these.
const TASK: usize = 200_000;

/// A column whose remainder is below this fraction of it depends on those before.
const DEPENDENT: f64 = 1e-13;

/// Residuals are tied when they differ by less than this fraction: columns that nearly depend on those before have lost
/// some digits. Distances are tied too: on a grid, many are equal but for rounding.
const TIED: f64 = 1e-9;

/// The data that become control points, in order: `first`, then repeatedly the datum with the largest residual among
/// those that are farther than `min_distance` from every control point.
///
/// `points` holds x and y in turn, `values` is row-major, any number of outputs a datum: a residual is the norm over them
/// when the thin-plate spline on the control points so far is fitted to all data by least squares. Residuals that
/// agree to 1e-9 are tied, and the smallest index comes first; distances that agree so are equal. Ends at `max_count`, when
/// no datum is left, or when no residual is above `rounding`, in the values' unit. A datum whose function depends
/// numerically on those before becomes no control point, and neither do those around it.
///
/// Fails if lengths do not agree, naming the first of them if some numbers are not finite, and if the first three are on
/// a line.
///
/// ```
/// use mexpress::{place::by_residual::place_by_residual, pool::Pool};
/// let flag = std::sync::atomic::AtomicBool::new(false);
/// // A square and its middle, which is 1 above the plane of the corners.
/// let points = [0.0, 0.0, 2.0, 0.0, 0.0, 2.0, 2.0, 2.0, 1.0, 1.0];
/// let values = [0.0, 0.0, 0.0, 0.0, 1.0];
/// let chosen = place_by_residual(&points, &values, [0, 1, 2], 4, 0.1, 1e-12, &Pool::new(1, &flag))?;
/// assert_eq!(chosen, [0, 1, 2, 4]);
/// # Ok::<(), mexpress::error::Error>(())
/// ```
pub fn place_by_residual(
    points: &[f64],
    values: &[f64],
    first: [usize; 3],
    max_count: usize,
    min_distance: f64,
    rounding: f64,
    pool: &Pool<'_>,
) -> Result<Vec<usize>, Error> {
    let mut sweep = Sweep::new(points, values, first, min_distance, rounding, pool)?;
    let mut chosen = first.to_vec();
    while chosen.len() < max_count {
        let Some(next) = sweep.worst() else { break };
        if sweep.add_control_point(next)? {
            chosen.push(next);
        }
    }
    Ok(chosen)
}

/// Points in coordinates of unit size about their middle. The scale is a power of two, so that distances that are equal
/// stay equal.
fn normalised(points: &[f64], min_distance: f64) -> Result<(Vec<[f64; 2]>, f64), Error> {
    if points.len() % 2 == 1 {
        return Err(Error::Length { expected: points.len() - 1, given: points.len() });
    }
    // In two steps, so that nothing overflows.
    let outer = unit_scale(points.iter().copied())?;
    let middle: [f64; 2] = array::from_fn(|axis| {
        let coordinates = points.iter().skip(axis).step_by(2);
        let (low, high) =
            coordinates.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &x| (x.min(low), x.max(high)));
        0.5 * (low * outer + high * outer)
    });
    let centred = |i: usize, axis: usize| points[2 * i + axis] * outer - middle[axis];
    let inner = unit_scale((0..points.len()).map(|i| centred(i / 2, i % 2)))?;
    let place = |i| array::from_fn(|axis| centred(i, axis) * inner);
    Ok(((0..points.len() / 2).map(place).collect(), min_distance * outer * inner))
}

/// The fit so far, and who may come next.
struct Sweep<'a> {
    pool: &'a Pool<'a>,
    points: Vec<[f64; 2]>,
    corners: [[f64; 2]; 3],
    /// Squared: control points are farther apart.
    limit: f64,
    /// What counts as a residual of zero.
    rounding: f64,
    blocks: Vec<Block>,
    /// Of the basis.
    columns: usize,
    last: Option<Remainder>,
}

impl<'a> Sweep<'a> {
    /// The affine fit; the first three control points are taken.
    fn new(
        points: &[f64],
        values: &[f64],
        first: [usize; 3],
        min_distance: f64,
        rounding: f64,
        pool: &'a Pool<'a>,
    ) -> Result<Self, Error> {
        let (points, min_distance) = normalised(points, min_distance)?;
        let outputs = values.len() / points.len().max(1);
        if values.len() != points.len() * outputs {
            return Err(Error::Length { expected: points.len() * outputs, given: values.len() });
        }
        if let Some(&index) = first.iter().find(|i| **i >= points.len()) {
            return Err(Error::Index { index, bound: points.len() });
        }
        let scale = unit_scale(values.iter().copied())?;
        let corners = first.map(|i| points[i]);
        if doubled_area(corners) == 0.0 {
            return Err(Error::Collinear { first });
        }
        let blocks = points
            .chunks(BLOCK_ROWS)
            .enumerate()
            .map(|(b, places)| {
                let rows = b * BLOCK_ROWS * outputs..(b * BLOCK_ROWS + places.len()) * outputs;
                Block::new(places, &values[rows], scale)
            })
            .collect();
        let (limit, rounding) = ((min_distance * (1.0 + TIED)).powi(2), rounding * scale);
        let mut sweep = Self { pool, points, corners, limit, rounding, blocks, columns: 0, last: None };
        sweep.pass(|block| {
            block.fill_kernels(corners);
            corners.iter().for_each(|&corner| block.exclude_near(corner, limit));
        })?;
        sweep.add(|block| block.column.fill(1.0))?;
        sweep.add(|block| block.column.copy_from_slice(&block.x))?;
        sweep.add(|block| block.column.copy_from_slice(&block.y))?;
        Ok(sweep)
    }

    /// The datum with the largest residual, if there is one.
    fn worst(&self) -> Option<usize> {
        let largest = self.blocks.iter().fold(0.0, |largest, block| f64::max(largest, block.largest)).sqrt();
        if largest <= self.rounding {
            return None;
        }
        let tied = (largest * (1.0 - TIED)).powi(2);
        let block = self.blocks.iter().position(|block| block.largest >= tied)?;
        let row = self.blocks[block].squares.iter().position(|square| *square >= tied)?;
        Some(block * BLOCK_ROWS + row)
    }

    /// Adds the function of a control point; false if it depends on those before. Either way the data around it are no
    /// candidates any more.
    fn add_control_point(&mut self, index: usize) -> Result<bool, Error> {
        let (centre, [a, b, c], limit) = (self.points[index], self.corners, self.limit);
        let part = |triangle| doubled_area(triangle) / doubled_area(self.corners);
        let (second, third) = (part([a, centre, c]), part([a, b, centre]));
        let weights = [1.0 - second - third, second, third];
        self.add(|block| {
            block.exclude_near(centre, limit);
            block.fill(centre, weights);
        })
    }

    /// Adds a column, unless it depends on those before, and looks at the residuals anew.
    fn add(&mut self, fill: impl Fn(&mut Block) + Sync) -> Result<bool, Error> {
        let last = self.last.take();
        self.columns += usize::from(last.is_some());
        let columns = self.columns;
        let whole = self.pass(|block| {
            if let Some(last) = &last {
                block.join_basis(last);
            }
            fill(block);
            block.project();
        })?;
        let once = self.pass(|block| {
            block.subtract(&whole[..columns]);
            block.project();
        })?;
        let last = Remainder::new(&once, columns, whole[columns]);
        self.pass(|block| block.square_residuals(last.as_ref()))?;
        self.last = last;
        Ok(self.last.is_some())
    }

    /// Does the work on every block; the total of what the blocks leave in `sums`.
    fn pass(&mut self, work: impl Fn(&mut Block) + Sync) -> Result<Vec<f64>, Error> {
        let blocks_a_task = TASK.div_ceil(BLOCK_ROWS * (self.columns + 1));
        self.pool.run(
            self.blocks.chunks_mut(blocks_a_task),
            || (),
            |(), task: &mut [Block]| {
                for block in task {
                    block.sums.clear();
                    work(block);
                }
            },
        )?;
        let mut totals = vec![0.0; self.blocks.first().map_or(0, |block| block.sums.len())];
        for block in &self.blocks {
            totals.iter_mut().zip(&block.sums).for_each(|(total, sum)| *total += sum);
        }
        Ok(totals)
    }
}

/// A column that has been made orthogonal to the basis once, and is about to join it.
struct Remainder {
    /// What is left of its products with the basis, to be taken away.
    products: Vec<f64>,
    /// What brings it to unit length then.
    unit: f64,
    /// The products of what joins the basis with the residuals.
    coefficients: Vec<f64>,
}

impl Remainder {
    /// From the column's products with the basis, with itself and with the residuals; none if nothing but rounding is left
    /// of the squared norm that the whole column had.
    fn new(products: &[f64], columns: usize, whole: f64) -> Option<Self> {
        let (products, rest) = products.split_at(columns);
        let square = rest[0] - products.iter().map(|p| p * p).sum::<f64>();
        let unit = square.sqrt().recip();
        let coefficients = rest[1..].iter().map(|product| product * unit).collect();
        (square > DEPENDENT * DEPENDENT * whole).then(|| Self {
            products: products.to_vec(),
            unit,
            coefficients,
        })
    }
}

/// Twice the signed area of a triangle.
fn doubled_area([a, b, c]: [[f64; 2]; 3]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Some of the data. Matrices are column-major.
#[derive(Default)]
struct Block {
    x: Vec<f64>,
    y: Vec<f64>,
    /// 1 for a candidate, 0 for the others.
    open: Vec<f64>,
    /// phi of the distances from the first three control points.
    kernels: [Vec<f64>; 3],
    basis: Vec<f64>,
    /// The column that is being added to the basis.
    column: Vec<f64>,
    residuals: Vec<f64>,
    /// Squared residuals of the candidates.
    squares: Vec<f64>,
    largest: f64,
    sums: Vec<f64>,
}

impl Block {
    fn new(points: &[[f64; 2]], values: &[f64], scale: f64) -> Self {
        let rows = points.len();
        let outputs = values.len() / rows;
        let zeros = || vec![0.0; rows];
        Self {
            x: points.iter().map(|point| point[0]).collect(),
            y: points.iter().map(|point| point[1]).collect(),
            open: vec![1.0; rows],
            kernels: array::from_fn(|_| zeros()),
            column: zeros(),
            residuals: (0..values.len()).map(|i| values[i % rows * outputs + i / rows] * scale).collect(),
            squares: zeros(),
            ..Self::default()
        }
    }

    /// Fills in the kernels of the first three control points.
    fn fill_kernels(&mut self, corners: [[f64; 2]; 3]) {
        for (kernel, corner) in self.kernels.iter_mut().zip(corners) {
            for ((value, x), y) in kernel.iter_mut().zip(&self.x).zip(&self.y) {
                *value = phi(squared_distance([*x, *y], corner));
            }
        }
    }

    /// Data that are not farther than the limit are no longer candidates.
    fn exclude_near(&mut self, centre: [f64; 2], limit: f64) {
        for ((open, x), y) in self.open.iter_mut().zip(&self.x).zip(&self.y) {
            *open = if squared_distance([*x, *y], centre) > limit { *open } else { 0.0 };
        }
    }

    /// The function of a control point; its weights on the first three are those that make it a thin-plate spline.
    fn fill(&mut self, centre: [f64; 2], weights: [f64; 3]) {
        let [first, second, third] = &self.kernels;
        for (i, value) in self.column.iter_mut().enumerate() {
            let combination = weights[0] * first[i] + weights[1] * second[i] + weights[2] * third[i];
            *value = phi(squared_distance([self.x[i], self.y[i]], centre)) - combination;
        }
    }

    /// Products of the new column with the basis, with itself, and with the residuals.
    fn project(&mut self) {
        for matrix in [&self.basis, &self.column, &self.residuals] {
            Arch::new().dispatch(Products { matrix, vector: &self.column, sums: &mut self.sums });
        }
    }

    /// Takes a combination of the basis from the new column.
    fn subtract(&mut self, factors: &[f64]) {
        Arch::new().dispatch(Difference { vector: &mut self.column, matrix: &self.basis, factors });
    }

    /// The column that was added last becomes orthogonal for good, joins the basis and leaves the residuals.
    fn join_basis(&mut self, last: &Remainder) {
        let rows = self.column.len();
        self.subtract(&last.products);
        for value in &mut self.column {
            *value *= last.unit;
        }
        for (residuals, coefficient) in self.residuals.chunks_exact_mut(rows).zip(&last.coefficients) {
            residuals.iter_mut().zip(&self.column).for_each(|(e, value)| *e -= coefficient * value);
        }
        self.basis.extend_from_slice(&self.column);
    }

    /// How large the candidates' residuals are once the new column has left them.
    fn square_residuals(&mut self, last: Option<&Remainder>) {
        self.squares.fill(0.0);
        for (output, residuals) in self.residuals.chunks_exact(self.column.len()).enumerate() {
            let factor = last.map_or(0.0, |last| last.coefficients[output] * last.unit);
            for ((square, e), value) in self.squares.iter_mut().zip(residuals).zip(&self.column) {
                *square += (e - factor * value).powi(2);
            }
        }
        self.largest = 0.0;
        for (square, open) in self.squares.iter_mut().zip(&self.open) {
            *square *= open;
            self.largest = self.largest.max(*square);
        }
    }
}

fn squared_distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    let (x, y) = (a[0] - b[0], a[1] - b[1]);
    x * x + y * y
}

/// phi, from r^2; the floor under the logarithm gives 0 at 0.
fn phi(square: f64) -> f64 {
    0.5 * square * square.max(f64::MIN_POSITIVE).ln()
}

/// Appends the products of a matrix' columns with a vector to `sums`.
struct Products<'a> {
    matrix: &'a [f64],
    vector: &'a [f64],
    sums: &'a mut Vec<f64>,
}

impl WithSimd for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let groups = self.matrix.chunks_exact(COLUMNS * self.vector.len());
        let rest = groups.remainder().chunks_exact(self.vector.len());
        for group in groups {
            self.sums.extend_from_slice(&products::<S, COLUMNS>(simd, group, self.vector));
        }
        for single in rest {
            self.sums.extend_from_slice(&products::<S, 1>(simd, single, self.vector));
        }
    }
}

#[inline(always)]
fn products<S: Simd, const C: usize>(simd: S, columns: &[f64], vector: &[f64]) -> [f64; C] {
    let (head, tail) = S::as_simd_f64s(vector);
    let columns: [_; C] = array::from_fn(|c| {
        let (start, end) = S::as_simd_f64s(&columns[c * vector.len()..(c + 1) * vector.len()]);
        (&start[..head.len()], end)
    });
    let mut sums = [simd.splat_f64s(0.0); C];
    for (i, v) in head.iter().enumerate() {
        for (sum, (start, _)) in sums.iter_mut().zip(&columns) {
            *sum = simd.mul_add_f64s(start[i], *v, *sum);
        }
    }
    array::from_fn(|c| {
        let end = columns[c].1.iter().zip(tail);
        end.fold(simd.reduce_sum_f64s(sums[c]), |sum, (a, b)| sum + a * b)
    })
}

/// Takes a combination of a matrix' columns from a vector.
struct Difference<'a> {
    vector: &'a mut [f64],
    matrix: &'a [f64],
    factors: &'a [f64],
}

impl WithSimd for Difference<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let rows = self.vector.len();
        let (groups, (factors, last)) =
            (self.matrix.chunks_exact(COLUMNS * rows), self.factors.as_chunks::<COLUMNS>());
        let rest = groups.remainder().chunks_exact(rows);
        for (group, factors) in groups.zip(factors) {
            subtract::<S, COLUMNS>(simd, self.vector, group, factors);
        }
        for (single, factor) in rest.zip(last) {
            subtract::<S, 1>(simd, self.vector, single, &[*factor]);
        }
    }
}

#[inline(always)]
fn subtract<S: Simd, const C: usize>(simd: S, vector: &mut [f64], columns: &[f64], factors: &[f64; C]) {
    let rows = vector.len();
    let (head, tail) = S::as_mut_simd_f64s(vector);
    let columns: [_; C] = array::from_fn(|c| {
        let (start, end) = S::as_simd_f64s(&columns[c * rows..(c + 1) * rows]);
        (&start[..head.len()], &end[..tail.len()])
    });
    let negative = factors.map(|factor| simd.splat_f64s(-factor));
    for (i, v) in head.iter_mut().enumerate() {
        for ((start, _), factor) in columns.iter().zip(negative) {
            *v = simd.mul_add_f64s(start[i], factor, *v);
        }
    }
    for (i, v) in tail.iter_mut().enumerate() {
        for ((_, end), factor) in columns.iter().zip(factors) {
            *v -= end[i] * factor;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use proptest::prelude::*;

    use super::*;
    use crate::fit::factor::{Factor, Problem};

    fn run(
        points: &[f64],
        values: &[f64],
        first: [usize; 3],
        count: usize,
        distance: f64,
    ) -> Result<Vec<usize>, Error> {
        let flag = AtomicBool::new(false);
        place_by_residual(points, values, first, count, distance, rounding(values), &Pool::new(1, &flag))
    }

    fn rounding(values: &[f64]) -> f64 {
        1e-12 * values.iter().fold(0.0, |largest, v| f64::max(largest, v.abs()))
    }

    fn at(points: &[f64], i: usize) -> [f64; 2] {
        [points[2 * i], points[2 * i + 1]]
    }

    /// Residuals of the spline on some control points, from a factorisation of its own.
    fn squared_residuals(points: &[f64], values: &[f64], chosen: &[usize]) -> Vec<f64> {
        let rows = points.len() / 2;
        let corners = [0, 1, 2].map(|k| at(points, chosen[k]));
        let [a, b, c] = corners;
        let mut design = Vec::new();
        for i in 0..rows {
            let place = at(points, i);
            design.extend([1.0, place[0], place[1]]);
            for &k in &chosen[3..] {
                let centre = at(points, k);
                let kernel = |other| phi(squared_distance(place, other));
                let weights = [[centre, b, c], [a, centre, c], [a, b, centre]]
                    .map(|triangle| doubled_area(triangle) / doubled_area(corners));
                let affine: f64 = (0..3).map(|j| weights[j] * kernel(corners[j])).sum();
                design.push(kernel(centre) - affine);
            }
        }
        let problem = Problem {
            design: &design,
            responses: values,
            root_weights: None,
            penalty: &[],
            rows,
            columns: chosen.len(),
        };
        let flag = AtomicBool::new(false);
        let residuals = Factor::new(&problem, &Pool::new(1, &flag)).unwrap().plain_residuals();
        residuals.chunks(values.len() / rows).map(|e| e.iter().map(|e| e * e).sum()).collect()
    }

    fn oracle(points: &[f64], values: &[f64], first: [usize; 3], count: usize, distance: f64) -> Vec<usize> {
        let mut chosen = first.to_vec();
        while chosen.len() < count {
            let mut squares = squared_residuals(points, values, &chosen);
            for (i, square) in squares.iter_mut().enumerate() {
                let near = |&k: &usize| squared_distance(at(points, i), at(points, k)) <= distance * distance;
                *square = if chosen.iter().any(near) { 0.0 } else { *square };
            }
            let worst = squares.iter().fold(0.0, |worst, square| f64::max(worst, *square)).sqrt();
            if worst <= rounding(values) {
                break;
            }
            chosen.extend(squares.iter().position(|square| square.sqrt() >= worst * (1.0 - 1e-9)));
        }
        chosen
    }

    /// Points, random or on a grid, and one to three outputs.
    fn clouds() -> impl Strategy<Value = (Vec<f64>, Vec<f64>)> {
        (6..60_usize, prop_oneof![Just(4), Just(1000)], 1..4_usize).prop_flat_map(|(n, cells, outputs)| {
            let places = prop::collection::vec((-cells..cells).prop_map(f64::from), 2 * n);
            let values = prop::collection::vec((-5..5).prop_map(f64::from), outputs * n);
            (places, values)
        })
    }

    fn spread(points: &[f64]) -> Option<[usize; 3]> {
        let area = |t: [usize; 3]| doubled_area(t.map(|i| at(points, i))).abs();
        let n = points.len() / 2;
        let triples = (0..n).map(|i| [i, (i + 1) % n, (i + 2) % n]);
        triples.max_by(|a, b| area(*a).total_cmp(&area(*b))).filter(|t| area(*t) > 0.0)
    }

    proptest! {
        #[test]
        fn every_step_is_what_a_refit_says((points, values) in clouds(), part in 0.05..0.3) {
            if let Some(first) = spread(&points) {
                let size = points.iter().fold(0.0, |size, x| f64::max(size, x.abs()));
                let found = run(&points, &values, first, 30, part * size).unwrap();
                prop_assert_eq!(found, oracle(&points, &values, first, 30, part * size));
            }
        }
    }

    /// A wavy surface over a slightly irregular grid.
    fn waves(side: usize) -> (Vec<f64>, Vec<f64>) {
        let place = |i: usize| {
            let (x, y) = ((i % side) as f64, (i / side) as f64);
            [x + 0.3 * (7.0 * y).sin(), y + 0.3 * (5.0 * x).cos()]
        };
        let points: Vec<f64> = (0..side * side).flat_map(place).collect();
        let values = points.chunks(2).map(|p| (0.3 * p[0]).sin() * (0.2 * p[1]).cos()).collect();
        (points, values)
    }

    #[test]
    fn threads_do_not_matter() {
        let (points, values) = waves(70);
        let flag = AtomicBool::new(false);
        let chosen = |threads| {
            let pool = Pool::new(threads, &flag);
            place_by_residual(&points, &values, [0, 69, 4830], 60, 1.0, 1e-12, &pool).unwrap()
        };
        assert_eq!(chosen(1).len(), 60);
        assert_eq!(chosen(1), chosen(2));
        assert_eq!(chosen(1), chosen(7));
    }

    #[test]
    fn positions_units_and_sizes_do_not_matter() {
        let (points, values) = waves(20);
        let expected = run(&points, &values, [0, 19, 380], 40, 1.0).unwrap();
        for (scale, size) in [(1e-150, 1e-290), (1e150, 1e290), (3.0, 7.0)] {
            let moved: Vec<f64> = points.iter().map(|x| x * scale).collect();
            let raised: Vec<f64> = values.iter().map(|v| v * size).collect();
            assert_eq!(run(&moved, &raised, [0, 19, 380], 40, scale).unwrap(), expected);
        }
        let far: Vec<f64> = points.iter().map(|x| x + 5e6).collect();
        assert_eq!(run(&far, &values, [0, 19, 380], 40, 1.0).unwrap(), expected);
    }

    #[test]
    fn exact_fits_need_nobody_else() {
        let (points, _) = waves(12);
        let plane: Vec<f64> = points.chunks(2).map(|p| 1000.0 + 0.1 * p[0] - 0.7 * p[1]).collect();
        for values in [plane, vec![3.0; 144], vec![0.0; 144], vec![]] {
            assert_eq!(run(&points, &values, [0, 11, 132], 20, 0.5).unwrap(), [0, 11, 132]);
        }
    }

    #[test]
    fn copies_and_functions_that_depend_are_left_out() {
        let mut points = vec![0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.6, 0.7, 0.6, 0.7, 0.6, 0.7 + 1e-9];
        let values = [0.0, 0.0, 0.0, 1.0, -1.0, 5.0];
        assert_eq!(run(&points, &values, [0, 1, 2], 9, 0.0).unwrap(), [0, 1, 2, 5]);
        points[11] = 0.8;
        assert_eq!(run(&points, &values, [0, 1, 2], 9, 0.0).unwrap(), [0, 1, 2, 5, 4]);
        assert_eq!(run(&points, &values, [0, 1, 2], 9, 0.1 + 1e-12).unwrap(), [0, 1, 2, 5]);
        assert_eq!(run(&points, &values, [0, 1, 2], 2, 0.0).unwrap(), [0, 1, 2]);
        assert_eq!(run(&points, &values, [0, 1, 2], 9, f64::INFINITY).unwrap(), [0, 1, 2]);
    }

    #[test]
    fn bad_arguments_are_named() {
        let points = [0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 0.0, 1.0];
        let values = [0.0, 1.0, 2.0, 4.0];
        let run = |points: &[f64], values: &[f64], first| run(points, values, first, 5, 0.0);
        assert_eq!(run(&points, &values, [0, 1, 2]), Err(Error::Collinear { first: [0, 1, 2] }));
        assert_eq!(run(&points, &values, [0, 1, 4]), Err(Error::Index { index: 4, bound: 4 }));
        assert_eq!(run(&points, &values[..3], [0, 1, 3]), Err(Error::Length { expected: 0, given: 3 }));
        assert_eq!(run(&points[..7], &values, [0, 1, 3]), Err(Error::Length { expected: 6, given: 7 }));
        assert_eq!(run(&[], &[], [0, 1, 3]), Err(Error::Index { index: 0, bound: 0 }));
        let undefined = [0.0, f64::NAN, 2.0, 4.0];
        assert_eq!(run(&points, &undefined, [0, 1, 3]), Err(Error::NotFinite { index: 1 }));
        assert_eq!(run(&[f64::INFINITY; 8], &values, [0, 1, 3]), Err(Error::NotFinite { index: 0 }));
    }

    #[test]
    fn the_work_can_be_called_off() {
        let (points, values) = waves(12);
        let flag = AtomicBool::new(true);
        let result = place_by_residual(&points, &values, [0, 11, 132], 20, 0.5, 0.0, &Pool::new(2, &flag));
        assert_eq!(result, Err(Error::Interrupted));
    }
}
