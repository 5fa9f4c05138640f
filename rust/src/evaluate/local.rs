//! Functions of which only a few are nonzero at a point: their combinations, slopes and elements at many points.

use crate::error::Error;
use crate::pool::Pool;

/// Points of a task.
const TASK: usize = 4096;

/// A value and its derivatives along x and y.
pub type Jet = [f64; 3];

/// Functions of the plane, of which few are nonzero at a point.
pub trait Local: Sync {
    /// How many may be nonzero at a point.
    const MOST: usize;

    /// Number of functions.
    fn count(&self) -> usize;

    /// Multiply-adds that finding those at a point is worth at most.
    fn search(&self) -> usize {
        100
    }

    /// Takes the index and the jet of every function that is nonzero at a point; what is taken twice is summed.
    fn visit(&self, point: [f64; 2], take: impl FnMut(usize, Jet));

    /// Their combinations at points: a row of `columns` numbers each, as the parameters have for each function.
    fn values(
        &self,
        points: &[f64],
        parameters: &[f64],
        columns: usize,
        pool: &Pool<'_>,
    ) -> Result<Vec<f64>, Error> {
        self.combined(points, parameters, columns, columns, pool, |row, parameters, jet| {
            for (sum, parameter) in row.iter_mut().zip(parameters) {
                *sum += jet[0] * parameter;
            }
        })
    }

    /// The derivatives of these along x and y: `columns` pairs each.
    fn slopes(
        &self,
        points: &[f64],
        parameters: &[f64],
        columns: usize,
        pool: &Pool<'_>,
    ) -> Result<Vec<f64>, Error> {
        self.combined(points, parameters, columns, 2 * columns, pool, |row, parameters, jet| {
            for (pair, parameter) in row.chunks_exact_mut(2).zip(parameters) {
                pair[0] += jet[1] * parameter;
                pair[1] += jet[2] * parameter;
            }
        })
    }

    /// Adds what each function gives, of jet and parameters, to the rows of points.
    fn combined(
        &self,
        points: &[f64],
        parameters: &[f64],
        columns: usize,
        width: usize,
        pool: &Pool<'_>,
        add: impl Fn(&mut [f64], &[f64], Jet) + Sync,
    ) -> Result<Vec<f64>, Error> {
        if parameters.len() != self.count() * columns {
            return Err(Error::Length { expected: self.count() * columns, given: parameters.len() });
        }
        let mut rows = vec![0.0; points.len() / 2 * width];
        if rows.is_empty() {
            return Ok(rows);
        }
        let tasks = points.chunks(2 * TASK).zip(rows.chunks_mut(width * TASK));
        pool.run(
            tasks,
            || (),
            |(), (points, rows)| {
                for (point, row) in points.as_chunks().0.iter().zip(rows.chunks_exact_mut(width)) {
                    self.visit(*point, |function, jet| {
                        add(row, &parameters[function * columns..][..columns], jet);
                    });
                }
            },
        )?;
        Ok(rows)
    }

    /// Indices and elements of the nonzero functions at points, `MOST` each, with zeros behind: number `order` of their jets.
    fn elements(&self, points: &[f64], order: usize) -> (Vec<usize>, Vec<f64>) {
        let size = points.len() / 2 * Self::MOST;
        let (mut functions, mut elements) = (vec![0; size], vec![0.0; size]);
        for (i, point) in points.as_chunks().0.iter().enumerate() {
            let mut place = i * Self::MOST;
            self.visit(*point, |function, jet| {
                (functions[place], elements[place]) = (function, jet[order]);
                place += 1;
            });
        }
        (functions, elements)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{bits, noise, pool};

    /// The constant one; beside it x in the right half plane, and y, twice, in the left one.
    struct Three;

    impl Local for Three {
        const MOST: usize = 3;

        fn count(&self) -> usize {
            3
        }

        fn visit(&self, [x, y]: [f64; 2], mut take: impl FnMut(usize, Jet)) {
            take(0, [1.0, 0.0, 0.0]);
            if x > 0.0 {
                take(1, [x, 1.0, 0.0]);
            } else {
                (0..2).for_each(|_| take(2, [y, 0.0, 1.0]));
            }
        }
    }

    #[test]
    fn values_and_slopes_are_sums_over_the_functions_at_a_point() {
        let points = [2.0, 5.0, -1.0, 7.0];
        // Two columns.
        let parameters = [1.0, 10.0, 3.0, 0.5, -2.0, 4.0];
        let values = Three.values(&points, &parameters, 2, &pool(1)).unwrap();
        assert_eq!(values, [7.0, 11.0, -27.0, 66.0]);
        let slopes = Three.slopes(&points, &parameters, 2, &pool(1)).unwrap();
        assert_eq!(slopes, [3.0, 0.0, 0.5, 0.0, 0.0, -4.0, 0.0, 8.0]);
        let short = Three.values(&points, &parameters[..5], 2, &pool(1));
        assert_eq!(short, Err(Error::Length { expected: 6, given: 5 }));
        assert_eq!(Three.values(&[], &parameters, 2, &pool(1)), Ok(Vec::new()));
    }

    #[test]
    fn elements_have_zeros_behind() {
        let points = [2.0, 5.0, -1.0, 7.0];
        assert_eq!(Three.elements(&points, 0), (vec![0, 1, 0, 0, 2, 2], vec![1.0, 2.0, 0.0, 1.0, 7.0, 7.0]));
        assert_eq!(Three.elements(&points, 1).1, [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(Three.elements(&points, 2).1, [0.0, 0.0, 0.0, 0.0, 1.0, 1.0]);
    }

    /// Of more points than a task has.
    #[test]
    fn every_point_has_its_own_value_on_any_number_of_threads() {
        let points = noise(2 * (TASK + 11), 5);
        let parameters = [0.5, 2.0, -1.0];
        let [one, three] =
            [1, 3].map(|threads| Three.values(&points, &parameters, 1, &pool(threads)).unwrap());
        assert_eq!(bits(&one), bits(&three));
        for (point, value) in points.chunks_exact(2).zip(&one) {
            assert_eq!(Three.values(point, &parameters, 1, &pool(1)).unwrap(), [*value]);
        }
    }
}
