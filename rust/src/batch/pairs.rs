//! Held-out pairs of problems side by side: equation (6) where all of them are far from rank loss.

use pulp::Simd;

use crate::batch::lanes::{Fits, add, dot};

/// The sum of the squares of a pair's `L^-1` up to which it is far from rank loss, `L L^T` being `I - H_KK` or M: their
/// least eigenvalue is then above its inverse, and at most four digits are lost.
const FAR: f64 = 1e4;

/// A pair's rows.
#[derive(Clone, Copy)]
pub(super) struct Pair<'a> {
    /// Those held out.
    pub held: &'a [usize],
    /// Those predicted, among them.
    pub validated: &'a [usize],
    /// Where among them.
    pub places: &'a [usize],
}

/// What pairs are solved in.
pub(super) struct System<'a, S: Simd> {
    /// Rows `[X | L]` of the factorisation `L L^T = I - X X^T`.
    rows: &'a mut [S::f64s],
    /// `L^-1`, row by row.
    inverse: &'a mut [S::f64s],
    /// Right-hand sides, then solutions.
    right: &'a mut [S::f64s],
}

/// Vectors that systems of pairs take, which hold out up to so many rows.
pub(super) fn vectors(held: usize, columns: usize, responses: usize) -> usize {
    let order = held.min(columns);
    order * (held.max(columns) + order) + order * (order + responses)
}

impl<'a, S: Simd> System<'a, S> {
    /// In a space for pairs that hold out up to so many rows.
    #[inline(always)]
    pub fn new(held: usize, columns: usize, space: &'a mut [S::f64s]) -> Self {
        let order = held.min(columns);
        let (rows, space) = space.split_at_mut(order * (held.max(columns) + order));
        let (inverse, right) = space.split_at_mut(order * order);
        Self { rows, inverse, right }
    }

    /// The weighted prediction residuals of a pair's validated rows, row-major, and whether they are of use.
    #[inline(always)]
    pub fn predict(&mut self, simd: S, fits: &Fits<'_, S>, pair: Pair<'_>, out: &mut [S::f64s]) -> S::m64s {
        match *pair.held {
            [] => simd.less_than_f64s(simd.splat_f64s(0.0), simd.splat_f64s(1.0)),
            [row] => Self::lone(simd, fits, row, out),
            _ if pair.held.len() <= fits.shape.columns => self.dual(simd, fits, pair, out),
            _ => self.primal(simd, fits, pair, out),
        }
    }

    /// `e / (1 - h)`, equation (3).
    #[inline(always)]
    fn lone(simd: S, fits: &Fits<'_, S>, row: usize, out: &mut [S::f64s]) -> S::m64s {
        let rows = fits.shape.rows;
        let mut least = simd.splat_f64s(1.0);
        for q in fits.basis.iter().skip(row).step_by(rows) {
            least = simd.negate_mul_add_f64s(*q, *q, least);
        }
        let inverse = simd.div_f64s(simd.splat_f64s(1.0), least);
        for (out, e) in out.iter_mut().zip(fits.residuals.iter().skip(row).step_by(rows)) {
            *out = simd.mul_f64s(*e, inverse);
        }
        simd.less_than_f64s(simd.splat_f64s(FAR.recip()), least)
    }

    /// `e_(K) = (I - Q_K Q_K^T)^-1 e_K`.
    #[inline(always)]
    fn dual(&mut self, simd: S, fits: &Fits<'_, S>, pair: Pair<'_>, out: &mut [S::f64s]) -> S::m64s {
        let (size, order) = (fits.shape, pair.held.len());
        let stride = size.columns + order;
        for (own, &row) in self.rows.chunks_exact_mut(stride).zip(pair.held) {
            own.iter_mut().zip(fits.basis.iter().skip(row).step_by(size.rows)).for_each(|(x, q)| *x = *q);
        }
        let sides = self.right.chunks_exact_mut(order).zip(fits.residuals.chunks_exact(size.rows));
        for (right, e) in sides {
            right.iter_mut().zip(pair.held).for_each(|(x, &row)| *x = e[row]);
        }
        let far = self.factor(simd, order, size.columns);
        for c in 0..size.responses {
            let z = self.solve(simd, (order, size.columns), c);
            for (out, &place) in out.iter_mut().skip(c).step_by(size.responses).zip(pair.places) {
                *out = z[place];
            }
        }
        far
    }

    /// `e_(T) = e_T + Q_T M^-1 Q_K^T e_K` with `M = I - Q_K^T Q_K`.
    #[inline(always)]
    fn primal(&mut self, simd: S, fits: &Fits<'_, S>, pair: Pair<'_>, out: &mut [S::f64s]) -> S::m64s {
        let (size, terms) = (fits.shape, pair.held.len());
        let (order, stride) = (size.columns, terms + size.columns);
        for (own, q) in self.rows.chunks_exact_mut(stride).zip(fits.basis.chunks_exact(size.rows)) {
            own.iter_mut().zip(pair.held).for_each(|(x, &row)| *x = q[row]);
        }
        let sides = self.right.chunks_exact_mut(order).zip(fits.residuals.chunks_exact(size.rows));
        for (right, e) in sides {
            for (x, own) in right.iter_mut().zip(self.rows.chunks_exact(stride)) {
                let mut sum = simd.splat_f64s(0.0);
                for (q, &row) in own.iter().zip(pair.held) {
                    sum = simd.mul_add_f64s(*q, e[row], sum);
                }
                *x = sum;
            }
        }
        let far = self.factor(simd, order, terms);
        for c in 0..size.responses {
            let z = self.solve(simd, (order, terms), c);
            for (out, &row) in out.iter_mut().skip(c).step_by(size.responses).zip(pair.validated) {
                let mut sum = fits.residuals[c * size.rows + row];
                for (z, q) in z.iter().zip(fits.basis.iter().skip(row).step_by(size.rows)) {
                    sum = simd.mul_add_f64s(*z, *q, sum);
                }
                *out = sum;
            }
        }
        far
    }

    /// Factorises `I - X X^T`, and tells whether it is far from singular.
    #[inline(always)]
    fn factor(&mut self, simd: S, order: usize, terms: usize) -> S::m64s {
        let (stride, one) = (terms + order, simd.splat_f64s(1.0));
        let mut squares = simd.splat_f64s(0.0);
        for a in 0..order {
            let (done, own) = self.rows.split_at_mut(a * stride);
            for (b, other) in done.chunks_exact(stride).enumerate() {
                let sum = dot(simd, &own[..terms + b], other);
                own[terms + b] = simd.neg_f64s(simd.mul_f64s(sum, self.inverse[b * order + b]));
            }
            let own = &own[..terms + a];
            let pivot = simd.sub_f64s(one, dot(simd, own, own));
            let inverse = simd.div_f64s(one, simd.sqrt_f64s(pivot));
            let (done, line) = self.inverse.split_at_mut(a * order);
            for b in 0..a {
                let mut sum = simd.splat_f64s(0.0);
                for k in b..a {
                    sum = simd.mul_add_f64s(own[terms + k], done[k * order + b], sum);
                }
                line[b] = simd.neg_f64s(simd.mul_f64s(sum, inverse));
                squares = simd.mul_add_f64s(line[b], line[b], squares);
            }
            line[a] = inverse;
            squares = simd.mul_add_f64s(inverse, inverse, squares);
        }
        simd.less_than_f64s(squares, simd.splat_f64s(FAR))
    }

    /// Solves for right-hand side c.
    #[inline(always)]
    fn solve(&mut self, simd: S, (order, terms): (usize, usize), c: usize) -> &[S::f64s] {
        let x = &mut self.right[c * order..(c + 1) * order];
        for a in 0..order {
            let l = &self.rows[a * (terms + order) + terms..][..a];
            let rest = simd.sub_f64s(x[a], dot(simd, l, &x[..a]));
            x[a] = simd.mul_f64s(rest, self.inverse[a * order + a]);
        }
        for a in (0..order).rev() {
            let (before, own) = x.split_at_mut(a);
            own[0] = simd.mul_f64s(own[0], self.inverse[a * order + a]);
            let l = &self.rows[a * (terms + order) + terms..][..a];
            add(simd, before, simd.neg_f64s(own[0]), l);
        }
        &x[..order]
    }
}
