//! Pairs close to rank loss, where the closed form loses digits: refined, solved with twice the digits, or refitted.

pub mod double_double;
pub(crate) mod refine;
pub mod refit;

use std::sync::OnceLock;

use self::refine::{Refiner, refinable};
use self::refit::Refit;
use crate::error::Error;
use crate::fit::factor::{Factor, Problem};
use crate::holdout::pairs::{Pairs, Status, Workspace, unweight};
use crate::holdout::visit::{Plan, Slot};
use crate::pool::Pool;

impl Factor {
    /// Solves the pairs that the closed form did not: refines them in small batches, and refits those for which that is
    /// not enough, each as a task of its own since it costs far more.
    pub(super) fn rescue(
        &self,
        problem: &Problem<'_>,
        pairs: &Pairs<'_>,
        plan: &Plan,
        residuals: &mut [f64],
        status: &mut [Option<Status>],
        pool: &Pool<'_>,
    ) -> Result<(), Error> {
        let mut rest = residuals;
        let mut left = Vec::new();
        for (pair, status) in status.iter_mut().enumerate() {
            let size = (plan.offsets[pair + 1] - plan.offsets[pair]) * self.responses;
            let (out, after) = rest.split_at_mut(size);
            rest = after;
            if status.is_none() {
                left.push((pair, Slot { residuals: out, status }));
            }
        }
        let failure = OnceLock::new();
        let batch = plan.batch(self.rank);
        pool.run(
            left.chunks_mut(batch),
            || (Refiner::default(), (0..batch).map(|_| Workspace::default()).collect::<Vec<_>>()),
            |(refining, workspaces), batch| {
                // Once called off, nobody reads the result.
                let _ = self.refine(plan, pairs, (refining, workspaces), batch, pool);
            },
        )?;
        left.retain(|(_, slot)| slot.status.is_none());
        pool.run(
            left.into_iter(),
            || (Refit::default(), Workspace::default()),
            |(refit, workspace), (pair, slot)| {
                workspace.list_rows(pairs, &[pair]);
                let kept = (&workspace.rows[..], workspace.validated);
                slot.residuals.fill(f64::NAN);
                match refit.predict(self, problem, pool, kept, slot.residuals) {
                    Ok(found) => *slot.status = Some(found),
                    Err(error) => drop(failure.set(error)),
                }
                unweight(self, &workspace.rows[..workspace.validated], slot.residuals);
            },
        )?;
        failure.into_inner().map_or(Ok(()), Err)
    }

    /// Refines those of a few pairs that can be refined.
    fn refine(
        &self,
        plan: &Plan,
        pairs: &Pairs<'_>,
        (refining, workspaces): (&mut Refiner, &mut [Workspace]),
        batch: &mut [(usize, Slot<'_>)],
        pool: &Pool<'_>,
    ) -> Result<(), Error> {
        let mut near_singular = Vec::with_capacity(batch.len());
        let mut status = Vec::with_capacity(batch.len());
        for (workspace, (pair, slot)) in workspaces.iter_mut().zip(batch) {
            workspace.list_rows(pairs, &[*pair]);
            let pair = workspace.near_singular(self, plan.hat.as_ref(), slot.residuals);
            if refinable(self, pair.least) {
                near_singular.push(pair);
                status.push(&mut *slot.status);
            }
        }
        let good = refining.refine(self, pool, &mut near_singular)?;
        for ((status, pair), good) in status.into_iter().zip(near_singular).zip(good) {
            if good {
                unweight(self, &pair.rows[..pair.validated], pair.out);
                *status = Some(Status::Refined);
            }
        }
        Ok(())
    }
}
