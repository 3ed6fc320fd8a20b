//! How a running reconstruction is watched and stopped: the [`Monitor`] the worker gives to the pipeline. Here is the clock the pipeline
//! does not have.

use crate::pipeline::monitor::{Monitor, Stage};
use std::{
    collections::{BTreeMap, HashMap},
    sync::{
        Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, ThreadId},
    time::{Duration, Instant, SystemTime},
};

/// Name of what follows on the last stage.
pub(super) const RESULTS: &str = "results";

/// What a running job has done so far.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Snapshot {
    /// Part of the work done, 0 to 1.
    pub fraction: f64,
    /// The stage that began last.
    pub stage: Option<Stage>,
    /// Gates finished.
    pub gates_done: u64,
}

/// When a stage ran. What follows on the last stage, results being made, counts as one.
#[derive(Debug, Clone, PartialEq)]
pub struct StageTime {
    /// Its name in JSON, metrics and traces.
    pub name: &'static str,
    /// When it first began, for whichever gate.
    pub began: SystemTime,
    /// When it last ended.
    pub ended: SystemTime,
    /// How often it ran: for the study, or for gates and surfaces.
    pub runs: u64,
    /// The time of all these runs, of which several may have been at once.
    pub busy: Duration,
}

/// Progress, timing and cancellation of one attempt at a job.
#[derive(Debug)]
pub struct Progress {
    began: Instant,
    /// The same moment by the calendar.
    began_at: SystemTime,
    cancelled: AtomicBool,
    state: Mutex<Timeline>,
}

#[derive(Debug, Default)]
struct Timeline {
    snapshot: Snapshot,
    /// Gates of the study.
    gates: u64,
    /// By thread too, since both surfaces of a gate are in the same stage at once; a list, since a thread that waits for one surface may
    /// begin the other's.
    under_way: HashMap<(Stage, Option<usize>, ThreadId), Vec<Instant>>,
    stages: BTreeMap<Stage, Ran>,
    results: Option<Ran>,
}

/// What is known of the runs of a stage that are over.
#[derive(Debug, Clone, Copy)]
struct Ran {
    began: Instant,
    ended: Instant,
    runs: u64,
    busy: Duration,
}

impl Ran {
    fn once(began: Instant, ended: Instant) -> Self {
        Self { began, ended, runs: 1, busy: ended.duration_since(began) }
    }

    fn and(self, other: Self) -> Self {
        Self {
            began: self.began.min(other.began),
            ended: self.ended.max(other.ended),
            runs: self.runs + other.runs,
            busy: self.busy + other.busy,
        }
    }
}

impl Progress {
    /// Begins now.
    pub fn begin_now() -> Self {
        Self { began: Instant::now(), began_at: SystemTime::now(), cancelled: AtomicBool::new(false), state: Mutex::default() }
    }

    fn state(&self) -> MutexGuard<'_, Timeline> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Says how many gates the study has; without it none is ever counted as done.
    pub fn expect_gates(&self, gates: usize) {
        self.state().gates = gates as u64;
    }

    /// Asks the reconstruction to stop.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    /// What was done so far.
    pub fn snapshot(&self) -> Snapshot {
        self.state().snapshot.clone()
    }

    /// Time since the beginning in ms.
    pub fn elapsed_ms(&self) -> f64 {
        self.began.elapsed().as_secs_f64() * 1e3
    }

    /// Time spent in each finished stage in ms, by [`Stage::name`], summed over gates. Gates run at once, so the sum may exceed
    /// [`Progress::elapsed_ms`].
    pub fn stages_ms(&self) -> BTreeMap<String, f64> {
        self.state().stages.iter().map(|(stage, ran)| (stage.name().to_owned(), ran.busy.as_secs_f64() * 1e3)).collect()
    }

    /// Notes that results were made from this moment until now, and says how long that is in s.
    pub fn results_made_since(&self, began: Instant) -> f64 {
        let made = Ran::once(began, Instant::now());
        self.state().results = Some(made);
        made.busy.as_secs_f64()
    }

    /// When each stage ran, as far as its runs are over, in the order of [`Stage::ALL`].
    pub fn stages(&self) -> Vec<StageTime> {
        let state = self.state();
        let stages = state.stages.iter().map(|(stage, ran)| (stage.name(), *ran));
        let at = |moment: Instant| self.began_at + moment.duration_since(self.began);
        let time = |(name, Ran { began, ended, runs, busy }): (_, Ran)| StageTime { name, began: at(began), ended: at(ended), runs, busy };
        stages.chain(state.results.map(|ran| (RESULTS, ran))).map(time).collect()
    }
}

impl Monitor for Progress {
    fn begin(&self, stage: Stage, gate: Option<usize>) {
        let mut state = self.state();
        state.snapshot.stage = Some(stage);
        state.under_way.entry((stage, gate, thread::current().id())).or_default().push(Instant::now());
    }

    fn end(&self, stage: Stage, gate: Option<usize>) {
        let mut state = self.state();
        if let Some(began) = state.under_way.get_mut(&(stage, gate, thread::current().id())).and_then(Vec::pop) {
            let ran = Ran::once(began, Instant::now());
            state.stages.entry(stage).and_modify(|before| *before = before.and(ran)).or_insert(ran);
        }
    }

    fn advance(&self, done: usize, total: usize) {
        if total == 0 {
            return;
        }
        let fraction = (done as f64 / total as f64).min(1.0);
        let mut state = self.state();
        state.snapshot.fraction = state.snapshot.fraction.max(fraction);
        // Units of work are gates, or steps that advance all gates alike. The stages of a gate run once a surface, so they do not tell when
        // it is done.
        let gates_done = state.gates * done.min(total) as u64 / total as u64;
        state.snapshot.gates_done = state.snapshot.gates_done.max(gates_done);
    }

    fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_never_goes_back_and_counts_finished_gates() {
        let progress = Progress::begin_now();
        progress.expect_gates(8);
        progress.advance(3, 8);
        progress.advance(2, 8);
        progress.begin(Stage::Edges, Some(0));
        progress.end(Stage::Edges, Some(0));
        progress.begin(Stage::Measurement, Some(0));
        progress.end(Stage::Measurement, Some(0));
        assert_eq!(progress.snapshot(), Snapshot { fraction: 0.375, stage: Some(Stage::Measurement), gates_done: 3 });
        assert_eq!(progress.stages_ms().keys().collect::<Vec<_>>(), ["edges", "measurement"]);
        progress.advance(50, 100);
        assert_eq!((progress.snapshot().fraction, progress.snapshot().gates_done), (0.5, 4), "other units count in proportion");
        progress.advance(100, 100);
        assert_eq!(progress.snapshot().gates_done, 8);
        assert!(!progress.is_cancelled());
        progress.cancel();
        assert!(progress.is_cancelled());
    }

    #[test]
    fn both_surfaces_of_a_gate_may_be_in_the_same_stage() {
        let progress = Progress::begin_now();
        progress.begin(Stage::Deformation, Some(0));
        progress.begin(Stage::Deformation, Some(0));
        thread::scope(|scope| {
            scope.spawn(|| {
                progress.begin(Stage::Deformation, Some(0));
                thread::sleep(std::time::Duration::from_millis(5));
                progress.end(Stage::Deformation, Some(0));
            });
        });
        progress.end(Stage::Deformation, Some(0));
        progress.end(Stage::Deformation, Some(0));
        assert!(progress.stages_ms()["deformation"] >= 15.0, "{:?}", progress.stages_ms());
        let [stage] = progress.stages().try_into().unwrap();
        assert_eq!((stage.name, stage.runs), ("deformation", 3));
        let span = stage.ended.duration_since(stage.began).unwrap();
        assert!(span >= Duration::from_millis(5) && span < stage.busy && stage.began >= progress.began_at, "{stage:?}");
        assert!(progress.results_made_since(Instant::now()) >= 0.0);
        assert_eq!(progress.stages().last().map(|stage| (stage.name, stage.runs)), Some((RESULTS, 1)));
    }
}
