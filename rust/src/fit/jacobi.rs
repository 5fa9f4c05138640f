//! Singular values by Jacobi's rotations: slow, but sure, where a faster algorithm turns in circles.
//!
//! Two columns after two are rotated until they are orthogonal to each other (one-sided Jacobi; Hestenes, 1958). What is left
//! of the columns are left vectors times singular values, and the rotations together are the right vectors.

use crate::error::Error;
use crate::fit::linalg::{Svd, dot, transposed};

/// Sweeps over all pairs of columns: some ten are enough as a rule.
const MOST_SWEEPS: usize = 100;

/// The thin singular value decomposition of a `rows` x `columns` matrix; left vectors of zero values are zero.
pub(super) fn thin_svd(a: &[f64], rows: usize, columns: usize) -> Result<Svd, Error> {
    if rows < columns {
        let Svd { u, s, v } = thin_svd(&transposed(a, rows), columns, rows)?;
        return Ok(Svd { u: v, s, v: u });
    }
    let mut left = a.to_vec();
    let mut right = vec![0.0; columns * columns];
    right.iter_mut().step_by(columns + 1).for_each(|x| *x = 1.0);
    if !(0..MOST_SWEEPS).any(|_| sweep(&mut left, &mut right, (rows, columns))) {
        return Err(Error::NoConvergence);
    }
    let lengths: Vec<f64> = left.chunks_exact(rows).map(|column| dot(column, column).sqrt()).collect();
    let mut order: Vec<usize> = (0..columns).collect();
    order.sort_by(|&i, &j| lengths[j].total_cmp(&lengths[i]));
    let unit = |&j: &usize| {
        let scale = if lengths[j] > 0.0 { lengths[j].recip() } else { 0.0 };
        left[j * rows..(j + 1) * rows].iter().map(move |x| x * scale)
    };
    Ok(Svd {
        u: order.iter().flat_map(unit).collect(),
        s: order.iter().map(|&j| lengths[j]).collect(),
        v: order.iter().flat_map(|&j| right[j * columns..(j + 1) * columns].iter().copied()).collect(),
    })
}

/// Rotates every two columns; true if all were orthogonal.
fn sweep(left: &mut [f64], right: &mut [f64], (rows, columns): (usize, usize)) -> bool {
    let orthogonal = rows as f64 * f64::EPSILON;
    let mut done = true;
    for j in 1..columns {
        for i in 0..j {
            let (before, y) = left.split_at_mut(j * rows);
            let (x, y) = (&mut before[i * rows..(i + 1) * rows], &mut y[..rows]);
            let [xx, yy, xy] = [dot(x, x), dot(y, y), dot(x, y)];
            if xy.abs() <= orthogonal * xx.sqrt() * yy.sqrt() {
                continue;
            }
            done = false;
            let ratio = (yy - xx) / (2.0 * xy);
            let tangent = ratio.signum() / (ratio.abs() + ratio.hypot(1.0));
            let cosine = tangent.hypot(1.0).recip();
            let turn = (cosine, cosine * tangent);
            rotate(x, y, turn);
            let (before, y) = right.split_at_mut(j * columns);
            rotate(&mut before[i * columns..(i + 1) * columns], &mut y[..columns], turn);
        }
    }
    done
}

fn rotate(x: &mut [f64], y: &mut [f64], (cosine, sine): (f64, f64)) {
    for (x, y) in x.iter_mut().zip(y) {
        (*x, *y) = (cosine * *x - sine * *y, sine * *x + cosine * *y);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::linalg::{self, product};
    use crate::testing::{assert_close, noise, pool};

    /// Tall, wide, square, of lower rank, and of columns that differ by decades.
    #[test]
    fn values_are_those_of_the_faster_algorithm_and_vectors_rebuild_the_matrix() {
        for (rows, columns, rank) in [(4, 4, 4), (9, 3, 3), (3, 7, 3), (20, 20, 13), (30, 12, 1), (5, 5, 0)] {
            let mut a = product(&noise(rows * rank, 1), &noise(rank * columns, 2), rows, rank, columns);
            a.chunks_exact_mut(rows).step_by(2).flatten().for_each(|x| *x *= 1e-6);
            let Svd { u, s, v } = thin_svd(&a, rows, columns).unwrap();
            let (size, plain) =
                (rows.min(columns), linalg::thin_svd(a.clone(), rows, columns, &pool(1)).unwrap());
            assert_close(&s, &plain.s, 1e-14);
            assert!(s.is_sorted_by(|x, y| x >= y));
            let scaled: Vec<f64> =
                u.chunks_exact(rows).zip(&s).flat_map(|(u, s)| u.iter().map(move |x| x * s)).collect();
            let across = transposed(&v, columns);
            assert_close(&product(&scaled, &across, rows, size, columns), &a, 1e-14);
            let (vectors, height) = if rows < columns { (&u, rows) } else { (&v, columns) };
            let gram = product(&transposed(vectors, height), vectors, size, height, size);
            let identity: Vec<f64> =
                (0..size * size).map(|k| f64::from(u8::from(k % (size + 1) == 0))).collect();
            assert_close(&gram, &identity, 1e-13);
        }
    }

    #[test]
    fn what_is_no_number_has_no_values() {
        assert_eq!(thin_svd(&[1.0, f64::NAN, 2.0, 3.0], 2, 2).err(), Some(Error::NoConvergence));
    }
}
