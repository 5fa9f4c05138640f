//! Dense factorisations on plain slices. The only file that names faer.
//!
//! Matrices are column-major here unless a name says otherwise. Everything runs on the calling thread:
//! parallelism is a matter of many calls, see [`crate::pool`].

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::householder::{
    apply_block_householder_sequence_on_the_left_in_place_scratch as apply_scratch,
    apply_block_householder_sequence_on_the_left_in_place_with_conj as apply_reflectors,
    apply_block_householder_sequence_transpose_on_the_left_in_place_scratch as transposed_scratch,
    apply_block_householder_sequence_transpose_on_the_left_in_place_with_conj as apply_transposed,
    make_householder_in_place,
};
use faer::linalg::matmul::dot::inner_prod;
use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::{svd, triangular_inverse, triangular_solve};
use faer::reborrow::{Reborrow, ReborrowMut};
use faer::{Accum, ColMut, Conj, Mat, MatMut, MatRef, Par};

use crate::error::Error;
use crate::fit::jacobi;
use crate::pool::Pool;

/// Sum of products, in eight running sums so that it vectorises; with wider vectors in work that `pulp` dispatches. They are
/// added by halves: most vectors are so short that additions one after another would take longest.
#[inline(always)]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let ((a8, a), (b8, b)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let ((a4, a), (b4, b)) = (a.as_chunks::<4>(), b.as_chunks::<4>());
    let mut eight = [0.0; 8];
    for (x, y) in a8.iter().zip(b8) {
        (0..8).for_each(|k| eight[k] += x[k] * y[k]);
    }
    let mut four: [f64; 4] = std::array::from_fn(|k| eight[k] + eight[k + 4]);
    for (x, y) in a4.iter().zip(b4) {
        (0..4).for_each(|k| four[k] += x[k] * y[k]);
    }
    let tail: f64 = a.iter().zip(b).map(|(x, y)| x * y).sum();
    (four[0] + four[2]) + (four[1] + four[3]) + tail
}

/// Scratch of the QR routines; one a thread.
pub struct QrScratch {
    memory: MemBuffer,
}

impl QrScratch {
    /// Enough for matrices of at most this shape.
    pub fn new(rows: usize, columns: usize) -> Self {
        let block = block_size(rows, columns);
        let apply = apply_scratch::<f64>(rows, block, columns);
        let transposed = transposed_scratch::<f64>(rows, block, columns);
        Self { memory: MemBuffer::new(StackReq::any_of(&[apply, transposed])) }
    }
}

/// Columns reflected together. A fixed number, and halves at powers of two, so that no bit of leading columns depends on
/// those that follow.
const BLOCK: usize = 32;

fn block_size(rows: usize, columns: usize) -> usize {
    BLOCK.min(rows).min(columns).max(1)
}

/// How many numbers the reflectors of a QR factorisation need beside the factored matrix.
pub fn reflector_size(rows: usize, columns: usize) -> usize {
    block_size(rows, columns) * rows.min(columns)
}

/// Most columns factored, or multiplied, between two looks at whether the work has been called off; fewer where each
/// takes long.
const MOST_COLUMNS: usize = 128;

/// Columns that take some hundredths of a second together when one of them takes `cost` multiply-adds.
fn short_run(cost: usize) -> usize {
    (100_000_000 / cost.max(1)).clamp(1, MOST_COLUMNS)
}

/// Householder QR: R replaces the upper triangle of `a`, the reflectors the rest and `reflectors`.
pub fn qr_in_place(
    a: &mut [f64],
    rows: usize,
    columns: usize,
    reflectors: &mut [f64],
    scratch: &mut QrScratch,
    pool: &Pool<'_>,
) -> Result<(), Error> {
    let block = block_size(rows, columns);
    let size = rows.min(columns);
    let mut a = MatMut::from_column_major_slice_mut(a, rows, columns);
    let mut h = MatMut::from_column_major_slice_mut(reflectors, block, size);
    let stack = MemStack::new(&mut scratch.memory);
    for first in (0..size).step_by(block) {
        let width = block.min(size - first);
        let (mut panel, mut rest) = a.rb_mut().get_mut(first.., first..).split_at_col_mut(width);
        let mut h = h.rb_mut().get_mut(..width, first..first + width);
        pool.proceed()?;
        reflect(panel.rb_mut(), h.rb_mut(), stack);
        let most = short_run(2 * rows * width);
        for at in (0..rest.ncols()).step_by(most) {
            pool.proceed()?;
            let count = most.min(rest.ncols() - at);
            let target = rest.rb_mut().subcols_mut(at, count);
            apply_transposed(panel.rb(), h.rb(), Conj::No, target, Par::Seq, stack);
        }
    }
    Ok(())
}

/// Columns that are reflected one by one.
const NARROW: usize = 4;

/// Householder QR of a panel, by halves. faer's own leaves out columns that are within 16 rows' rounding of those before,
/// which is far more than rank is judged by; this one takes every column, so that its error is a few roundings.
fn reflect(mut panel: MatMut<'_, f64>, mut h: MatMut<'_, f64>, stack: &mut MemStack) {
    let width = panel.ncols();
    if width <= NARROW {
        (0..width).for_each(|k| h[(k, k)] = reflect_column(panel.rb_mut().get_mut(k.., k..)));
        for l in 1..width {
            for k in 0..l {
                let (v, w) = (panel.rb().col(k).get(l + 1..), panel.rb().col(l).get(l + 1..));
                h[(k, l)] = panel[(l, k)] + inner_prod(v.transpose(), Conj::No, w, Conj::No);
            }
        }
        return;
    }
    let half = width.next_power_of_two() / 2;
    let (mut left, mut right) = panel.split_at_col_mut(half);
    let (mut h_left, mut h_across, _, mut h_right) = h.split_at_mut(half, half);
    reflect(left.rb_mut(), h_left.rb_mut(), stack);
    apply_transposed(left.rb(), h_left.rb(), Conj::No, right.rb_mut(), Par::Seq, stack);
    let mut lower = right.get_mut(half.., ..);
    reflect(lower.rb_mut(), h_right.rb_mut(), stack);
    let (v, w) = (left.rb().get(half.., ..), lower.rb());
    let (v_top, v_rest) = v.split_at_row(w.ncols());
    let (w_top, w_rest) = w.split_at_row(w.ncols());
    triangular::matmul(
        h_across.rb_mut(),
        BlockStructure::Rectangular,
        Accum::Replace,
        v_top.transpose(),
        BlockStructure::Rectangular,
        w_top,
        BlockStructure::UnitTriangularLower,
        1.0,
        Par::Seq,
    );
    matmul(h_across, Accum::Add, v_rest.transpose(), w_rest, 1.0, Par::Seq);
}

/// The reflection of a column `(head, v)` to a multiple of the first unit vector: `I - u u^T / tau` with `u = (1, v)` of
/// what v becomes; returns tau.
pub fn householder(head: &mut f64, v: &mut [f64]) -> f64 {
    make_householder_in_place(head, ColMut::from_slice_mut(v)).tau
}

/// Reflects the first column of a matrix to a multiple of the first unit vector, and the others along.
fn reflect_column(a: MatMut<'_, f64>) -> f64 {
    let mut columns =
        a.col_iter_mut().filter_map(|column| column.try_as_col_major_mut()?.as_slice_mut().split_first_mut());
    let Some((head, v)) = columns.next() else { return f64::INFINITY };
    let tau = householder(head, v);
    for (head, rest) in columns {
        let along = (*head + dot(v, rest)) / tau;
        *head -= along;
        rest.iter_mut().zip(&*v).for_each(|(x, v)| *x -= along * v);
    }
    tau
}

/// `c <- Q c` for the Q of [`qr_in_place`], `c` of `rows` x `width`.
pub fn apply_q(
    a: &[f64],
    shape: (usize, usize),
    reflectors: &[f64],
    c: &mut [f64],
    scratch: &mut QrScratch,
    pool: &Pool<'_>,
) -> Result<(), Error> {
    let stack = MemStack::new(&mut scratch.memory);
    reflect_parts(a, shape, reflectors, c, pool, |basis, h, c| {
        apply_reflectors(basis, h, Conj::No, c, Par::Seq, stack);
    })
}

/// `c <- Q^T c` for the Q of [`qr_in_place`], `c` of `rows` x `width`.
pub fn apply_q_transposed(
    a: &[f64],
    shape: (usize, usize),
    reflectors: &[f64],
    c: &mut [f64],
    scratch: &mut QrScratch,
    pool: &Pool<'_>,
) -> Result<(), Error> {
    let stack = MemStack::new(&mut scratch.memory);
    reflect_parts(a, shape, reflectors, c, pool, |basis, h, c| {
        apply_transposed(basis, h, Conj::No, c, Par::Seq, stack);
    })
}

/// Applies reflections, given with their blocks, to some columns after others.
fn reflect_parts(
    a: &[f64],
    (rows, columns): (usize, usize),
    reflectors: &[f64],
    c: &mut [f64],
    pool: &Pool<'_>,
    mut apply: impl FnMut(MatRef<'_, f64>, MatRef<'_, f64>, MatMut<'_, f64>),
) -> Result<(), Error> {
    let (block, size) = (block_size(rows, columns), rows.min(columns));
    let basis = MatRef::from_column_major_slice(a, rows, columns).subcols(0, size);
    let h = MatRef::from_column_major_slice(reflectors, block, size);
    for part in c.chunks_mut(rows * short_run(2 * rows * size)) {
        pool.proceed()?;
        apply(basis, h, MatMut::from_column_major_slice_mut(part, rows, part.len() / rows));
    }
    Ok(())
}

/// Singular value decomposition `U diag(s) V^T`, the values in decreasing order.
pub struct Svd {
    /// rows x min(rows, columns); where a value is zero, what it is is open.
    pub u: Vec<f64>,
    /// min(rows, columns).
    pub s: Vec<f64>,
    /// columns x min(rows, columns).
    pub v: Vec<f64>,
}

/// Larger decompositions take long enough to be called off.
const LONG_SVD: usize = 200;

/// The thin singular value decomposition of a `rows` x `columns` matrix.
pub fn thin_svd(a: Vec<f64>, rows: usize, columns: usize, pool: &Pool<'_>) -> Result<Svd, Error> {
    if rows.min(columns) < LONG_SVD {
        decompose(&a, rows, columns)
    } else {
        pool.aside(move || decompose(&a, rows, columns))?
    }
}

fn decompose(a: &[f64], rows: usize, columns: usize) -> Result<Svd, Error> {
    let size = rows.min(columns);
    let (mut u, mut s, mut v) = (Mat::zeros(rows, size), faer::Col::zeros(size), Mat::zeros(columns, size));
    let thin = svd::ComputeSvdVectors::Thin;
    let request = svd::svd_scratch::<f64>(rows, columns, thin, thin, Par::Seq, Default::default());
    let found = svd::svd(
        MatRef::from_column_major_slice(a, rows, columns),
        s.as_diagonal_mut(),
        Some(u.as_mut()),
        Some(v.as_mut()),
        Par::Seq,
        MemStack::new(&mut MemBuffer::new(request)),
        Default::default(),
    );
    if found.is_err() {
        return jacobi::thin_svd(a, rows, columns);
    }
    Ok(Svd { u: columns_of(u.as_ref()), s: s.iter().copied().collect(), v: columns_of(v.as_ref()) })
}

fn columns_of(a: MatRef<'_, f64>) -> Vec<f64> {
    a.col_iter().flat_map(|column| column.iter().copied().collect::<Vec<_>>()).collect()
}

/// Larger triangles take long enough to invert to be called off.
const LONG_INVERSE: usize = 600;

/// The Frobenius norm of the inverse of an upper triangular matrix; infinite for a zero on the diagonal.
pub fn inverse_norm(r: &[f64], order: usize, pool: &Pool<'_>) -> Result<f64, Error> {
    if order < LONG_INVERSE {
        Ok(norm_of_inverse(r, order))
    } else {
        let r = r.to_vec();
        pool.aside(move || norm_of_inverse(&r, order))
    }
}

fn norm_of_inverse(r: &[f64], order: usize) -> f64 {
    if (0..order).any(|j| r[j * order + j] == 0.0) {
        return f64::INFINITY;
    }
    let mut inverse = Mat::zeros(order, order);
    let r = MatRef::from_column_major_slice(r, order, order);
    triangular_inverse::invert_upper_triangular(inverse.as_mut(), r, Par::Seq);
    inverse.norm_l2()
}

/// `x <- R^-1 x`, with R the upper triangle of the leading block of a matrix of `stride` rows, and x (order x width).
pub fn solve_upper(r: &[f64], stride: usize, order: usize, x: &mut [f64], width: usize) {
    triangular_solve::solve_upper_triangular_in_place(
        MatRef::from_column_major_slice(&r[..stride * order], stride, order).subrows(0, order),
        MatMut::from_column_major_slice_mut(x, order, width),
        Par::Seq,
    );
}

/// `x <- L^-1 x`, with L the lower triangle of a square matrix, and x (order x width).
pub fn solve_lower(lower: &[f64], order: usize, x: &mut [f64], width: usize) {
    triangular_solve::solve_lower_triangular_in_place(
        MatRef::from_column_major_slice(lower, order, order),
        MatMut::from_column_major_slice_mut(x, order, width),
        Par::Seq,
    );
}

/// The upper triangle of a matrix of some height, square, with zeros below.
pub fn upper_triangle(a: &[f64], height: usize, columns: usize) -> Vec<f64> {
    let mut upper = vec![0.0; columns * columns];
    for (j, column) in upper.chunks_exact_mut(columns.max(1)).enumerate() {
        column[..=j].copy_from_slice(&a[j * height..=j * height + j]);
    }
    upper
}

/// Rows and columns of a tile: while what it holds goes to other places, both stay in the cache.
const TILE: usize = 32;

/// A matrix of columns (rows) of some length with its rows (columns) for them.
pub fn transposed(a: &[f64], length: usize) -> Vec<f64> {
    let count = a.len() / length.max(1);
    let mut out = vec![0.0; a.len()];
    for top in (0..length).step_by(TILE) {
        for left in (0..count).step_by(TILE) {
            for i in top..length.min(top + TILE) {
                for j in left..count.min(left + TILE) {
                    out[i * count + j] = a[j * length + i];
                }
            }
        }
    }
    out
}

/// `a b` for a (rows x inner) and b (inner x columns).
pub fn product(a: &[f64], b: &[f64], rows: usize, inner: usize, columns: usize) -> Vec<f64> {
    let mut c = vec![0.0; rows * columns];
    multiply(a, b, inner, (rows, columns), &mut c);
    c
}

/// Columns of a product that are one task, and the multiply-adds that they take at most, unless its columns are long.
const PRODUCT_COLUMNS: usize = 256;
const PRODUCT_COST: usize = 1 << 25;

/// [`product`] in blocks of columns, which threads share.
pub fn product_in_blocks(
    a: &[f64],
    b: &[f64],
    (rows, inner, columns): (usize, usize, usize),
    pool: &Pool<'_>,
) -> Result<Vec<f64>, Error> {
    let mut c = vec![0.0; rows * columns];
    let block = (PRODUCT_COST / (rows * inner).max(1)).clamp(16, PRODUCT_COLUMNS);
    let blocks = c.chunks_mut((block * rows).max(1)).zip(b.chunks((block * inner).max(1)));
    pool.run(blocks, || (), |(), (c, b)| multiply(a, b, inner, (rows, c.len() / rows), c))?;
    Ok(c)
}

fn multiply(a: &[f64], b: &[f64], inner: usize, (rows, columns): (usize, usize), c: &mut [f64]) {
    matmul(
        MatMut::from_column_major_slice_mut(c, rows, columns),
        Accum::Replace,
        MatRef::from_column_major_slice(a, rows, inner),
        MatRef::from_column_major_slice(b, inner, columns),
        1.0,
        Par::Seq,
    );
}

/// `out <- a^T b`, with a (rows x columns) and b (rows x width) row-major, out (columns x width) column-major.
pub fn transposed_product(a: &[f64], b: &[f64], columns: usize, width: usize, out: &mut [f64]) {
    let rows = a.len() / columns.max(1);
    matmul(
        MatMut::from_column_major_slice_mut(out, columns, width),
        Accum::Replace,
        MatRef::from_column_major_slice(a, columns, rows),
        MatRef::from_column_major_slice(b, width, rows).transpose(),
        1.0,
        Par::Seq,
    );
}

/// `out <- a b`, with a (rows x columns) row-major, b (columns x width) column-major, out (rows x width) row-major.
pub fn rows_product(a: &[f64], b: &[f64], columns: usize, width: usize, out: &mut [f64]) {
    let rows = a.len() / columns.max(1);
    matmul(
        MatMut::from_row_major_slice_mut(out, rows, width),
        Accum::Replace,
        MatRef::from_row_major_slice(a, rows, columns),
        MatRef::from_column_major_slice(b, columns, width),
        1.0,
        Par::Seq,
    );
}

/// `a b^T` for row-major matrices of some columns, written to the columns `start..` of a row-major matrix of `width` columns.
pub fn inner_products(a: &[f64], b: &[f64], columns: usize, out: &mut [f64], (start, width): (usize, usize)) {
    let height = |matrix: &[f64]| matrix.len().checked_div(columns).unwrap_or(0);
    let (rows, count) = (height(a), height(b));
    matmul(
        MatMut::from_row_major_slice_mut(&mut out[..rows * width], rows, width).subcols_mut(start, count),
        Accum::Replace,
        MatRef::from_row_major_slice(a, rows, columns),
        MatRef::from_row_major_slice(b, count, columns).transpose(),
        1.0,
        Par::Seq,
    );
}

/// The lower triangle of `a a^T` for the rows `first..` of a row-major matrix of some columns, against all rows up to
/// their own: as many rows as a row-major matrix of `width` columns has, written to its columns `start..`.
pub fn gram_rows(a: &[f64], columns: usize, first: usize, out: &mut [f64], (start, width): (usize, usize)) {
    let count = out.len() / width;
    let (before, here) = (&a[..first * columns], &a[first * columns..(first + count) * columns]);
    inner_products(here, before, columns, out, (start, width));
    let here = MatRef::from_row_major_slice(here, count, columns);
    triangular::matmul(
        MatMut::from_row_major_slice_mut(out, count, width).subcols_mut(start + first, count),
        BlockStructure::TriangularLower,
        Accum::Replace,
        here,
        BlockStructure::Rectangular,
        here.transpose(),
        BlockStructure::Rectangular,
        1.0,
        Par::Seq,
    );
}

/// Copies the lower triangle of a square matrix to the upper one.
pub fn mirror(a: &mut [f64], order: usize) {
    for top in (0..order).step_by(TILE) {
        for left in (0..=top).step_by(TILE) {
            for i in top..order.min(top + TILE) {
                for j in left..i.min(left + TILE) {
                    a[j * order + i] = a[i * order + j];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: &[f64], b: &[f64]) -> bool {
        a.len() == b.len() && a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-13)
    }

    fn matrix(rows: usize, columns: usize) -> Vec<f64> {
        (0..rows * columns).map(|i| ((i * 7919 + i * i % 977) % 1000) as f64 / 500.0 - 1.0).collect()
    }

    #[test]
    fn q_times_r_is_the_matrix() {
        let never = std::sync::atomic::AtomicBool::new(false);
        let pool = Pool::new(1, &never);
        for (rows, columns) in [(1, 1), (5, 3), (3, 5), (40, 33), (300, 130), (400, 390), (200, 450)] {
            let a = matrix(rows, columns);
            let size = rows.min(columns);
            let (mut f, mut h) = (a.clone(), vec![0.0; reflector_size(rows, columns)]);
            let mut scratch = QrScratch::new(rows, columns);
            qr_in_place(&mut f, rows, columns, &mut h, &mut scratch, &pool).unwrap();
            let mut r = vec![0.0; rows * columns];
            for j in 0..columns {
                for i in 0..size.min(j + 1) {
                    r[j * rows + i] = f[j * rows + i];
                }
            }
            let triangle = r.clone();
            apply_q(&f, (rows, columns), &h, &mut r, &mut scratch, &pool).unwrap();
            assert!(close(&r, &a), "{rows} x {columns}");
            apply_q_transposed(&f, (rows, columns), &h, &mut r, &mut scratch, &pool).unwrap();
            assert!(close(&r, &triangle), "{rows} x {columns}");
        }
    }

    #[test]
    fn singular_values_rebuild_the_matrix() {
        for (rows, columns) in [(4, 4), (7, 3), (3, 7)] {
            let a = matrix(rows, columns);
            let Svd { u, s, v } = decompose(&a, rows, columns).unwrap();
            let k = s.len();
            let mut scaled = vec![0.0; k * columns];
            for j in 0..columns {
                for i in 0..k {
                    scaled[j * k + i] = s[i] * v[i * columns + j];
                }
            }
            assert!(close(&product(&u, &scaled, rows, k, columns), &a));
        }
    }

    /// Of one block, and of several.
    #[test]
    fn blocks_of_a_product_are_the_product() {
        let never = std::sync::atomic::AtomicBool::new(false);
        for (rows, inner, columns) in [(2, 3, 5), (1, 2, 700), (200, 900, 230), (3, 0, 2), (0, 2, 3)] {
            let (a, b) = (matrix(rows, inner), matrix(inner, columns));
            let exact = product(&a, &b, rows, inner, columns);
            let found = [1, 3].map(|threads| {
                product_in_blocks(&a, &b, (rows, inner, columns), &Pool::new(threads, &never)).unwrap()
            });
            let near = |(x, y): (&f64, &f64)| (x - y).abs() < 1e-11;
            assert!(found[0].len() == exact.len() && found[0].iter().zip(&exact).all(near));
            assert_eq!(found[0], found[1]);
        }
    }

    #[test]
    fn gram_rows_are_inner_products() {
        let (rows, columns) = (9, 4);
        let a = matrix(rows, columns);
        for first in [0, 2, 6] {
            let mut out = vec![0.0; (rows - first) * rows];
            gram_rows(&a, columns, first, &mut out, (0, rows));
            for i in first..rows {
                for j in 0..=i {
                    let exact = dot(&a[i * columns..(i + 1) * columns], &a[j * columns..(j + 1) * columns]);
                    assert!((out[(i - first) * rows + j] - exact).abs() < 1e-14);
                }
            }
        }
    }

    #[test]
    fn a_mirrored_matrix_is_symmetric() {
        for order in [1, 31, 70] {
            let lower = |i: usize, j: usize| (i.max(j) * 100 + i.min(j)) as f64;
            let entry = |k: usize| if k % order > k / order { -1.0 } else { lower(k / order, k % order) };
            let mut a: Vec<f64> = (0..order * order).map(entry).collect();
            mirror(&mut a, order);
            assert!((0..order * order).all(|k| a[k] == lower(k / order, k % order)));
        }
    }
}
