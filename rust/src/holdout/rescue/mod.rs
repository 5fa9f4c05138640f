//! Pairs close to rank loss, where the closed form loses digits: refined, solved with twice the digits, or refitted.

pub mod double_double;
pub(crate) mod refine;
pub mod refit;

use std::sync::OnceLock;

use self::refine::{Batch, refinable};
use self::refit::Refit;
use crate::error::Error;
use crate::fit::factor::{Factor, Problem};
use crate::holdout::pairs::{Pairs, Status, Workspace, unweight};
use crate::holdout::visit::{Plan, Slot};
use crate::pool::Pool;

impl Factor {
    /// The pairs that the closed form left: refined in small batches, and refitted where that does not do, each a task
    /// of its own, since it costs far more.
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
            || (Batch::default(), (0..batch).map(|_| Workspace::default()).collect::<Vec<_>>()),
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
                workspace.gather(pairs, &[pair]);
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

    /// Refines what can be, of a few pairs.
    fn refine(
        &self,
        plan: &Plan,
        pairs: &Pairs<'_>,
        (refining, workspaces): (&mut Batch, &mut [Workspace]),
        batch: &mut [(usize, Slot<'_>)],
        pool: &Pool<'_>,
    ) -> Result<(), Error> {
        let mut suspects = Vec::with_capacity(batch.len());
        let mut status = Vec::with_capacity(batch.len());
        for (workspace, (pair, slot)) in workspaces.iter_mut().zip(batch) {
            workspace.gather(pairs, &[*pair]);
            let suspect = workspace.suspect(self, plan.hat.as_ref(), slot.residuals);
            if refinable(self, suspect.least) {
                suspects.push(suspect);
                status.push(&mut *slot.status);
            }
        }
        let good = refining.refine(self, pool, &mut suspects)?;
        for ((status, suspect), good) in status.into_iter().zip(suspects).zip(good) {
            if good {
                unweight(self, &suspect.rows[..suspect.validated], suspect.out);
                *status = Some(Status::Refined);
            }
        }
        Ok(())
    }
}
