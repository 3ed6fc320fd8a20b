//! Who works: tasks that claim a job when they are free, compute it on their own thread and keep its lease meanwhile.

use super::{
    backoff::{self, Backoff},
    compute::ComputeThread,
    error::StoreError,
    input,
    job::{JobError, State},
    lease::{Claim, Finish, Heartbeat, Outcome},
    progress::{Progress, Snapshot},
    reaper,
    settings::WorkerSettings,
    store::Store,
    traced::{self, Step, Without},
    work::{Output, WorkError},
};
use futures_util::future::join_all;
use std::{
    io,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};
use tokio::{
    sync::{oneshot, watch},
    task::{AbortHandle, JoinHandle},
    time::{Instant, MissedTickBehavior, interval, sleep, timeout},
};
use tracing::{Instrument as _, field};

/// How long a computation that was told to stop may take to do so before its job is given back without it.
const STOP_GRACE: Duration = Duration::from_secs(1);
/// How long giving back may take at the end of a drain.
const GIVE_BACK_TIME: Duration = Duration::from_secs(5);

/// What a drain came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Drained {
    /// Jobs that were running and went back to the queue, uncharged.
    pub given_back: usize,
}

/// The running workers and the reaper of this process. Dropping it stops them without waiting; what they held stays leased until it
/// is reaped or the store is opened again.
#[derive(Debug)]
pub struct Workers {
    phase: watch::Sender<Phase>,
    tasks: Mutex<Vec<JoinHandle<usize>>>,
    stops: Vec<AbortHandle>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Phase {
    Claiming,
    Draining,
    GivingBack,
}

/// Starts the workers and the reaper on the current runtime.
#[expect(clippy::needless_pass_by_value, reason = "the store and the settings are the workers' from here on")]
pub fn start_workers(store: Store, settings: WorkerSettings) -> io::Result<Workers> {
    let (phase, seen_phase) = watch::channel(Phase::Claiming);
    store.inner.queue.served_by(settings.workers);
    let compute = (1..=settings.workers).map(|number| ComputeThread::start(&format!("worker-{number}"))).collect::<io::Result<Vec<_>>>()?;
    let tasks: Vec<JoinHandle<usize>> = (1..)
        .zip(compute)
        .map(|(number, compute)| {
            let name = format!("{}/worker-{number}", settings.node);
            tokio::spawn(Worker { store: store.clone(), settings: settings.clone(), name, compute, phase: seen_phase.clone() }.run())
        })
        .collect();
    let reaper = tokio::spawn(reaper::run(store));
    let stops = tasks.iter().map(JoinHandle::abort_handle).chain([reaper.abort_handle()]).collect();
    Ok(Workers { phase, tasks: Mutex::new(tasks), stops })
}

impl Workers {
    /// Claims nothing more, waits for the running jobs at most so long, then stops them and gives them back, uncharged.
    pub async fn drain(&self, patience: Duration) -> Drained {
        let tasks = std::mem::take(&mut *self.tasks.lock().unwrap_or_else(PoisonError::into_inner));
        self.phase.send_replace(Phase::Draining);
        let mut ends = std::pin::pin!(join_all(tasks));
        let ended = if let Ok(ended) = timeout(patience, &mut ends).await {
            ended
        } else {
            self.phase.send_replace(Phase::GivingBack);
            timeout(STOP_GRACE + GIVE_BACK_TIME, &mut ends).await.unwrap_or_default()
        };
        self.stop();
        Drained { given_back: ended.into_iter().map(Result::unwrap_or_default).sum() }
    }

    /// Whether every worker and the reaper still run.
    pub fn alive(&self) -> bool {
        *self.phase.borrow() == Phase::Claiming && self.stops.iter().all(|task| !task.is_finished())
    }

    fn stop(&self) {
        self.stops.iter().for_each(AbortHandle::abort);
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        self.stop();
    }
}

struct Worker {
    store: Store,
    settings: WorkerSettings,
    name: String,
    compute: ComputeThread,
    phase: watch::Receiver<Phase>,
}

impl Worker {
    /// Works until drained; returns how many jobs were given back.
    async fn run(mut self) -> usize {
        let mut given_back = 0;
        let mut backoff = Backoff::default();
        while *self.phase.borrow() == Phase::Claiming {
            match self.store.claim(&self.name).await {
                Ok(Some(claim)) => {
                    backoff = Backoff::default();
                    // Where one job was, there may be another for a worker that was not told.
                    self.store.inner.work_ready.notify_one();
                    let traced = traced::span(&self.settings.traces, &self.store, &claim);
                    let span = tracing::info_span!("job", job_id = %claim.id, attempt = claim.attempt, trace_id = traced.trace_id().map(field::display));
                    given_back += usize::from(traced.scope(self.work_on(claim)).instrument(span).await);
                    traced.end();
                }
                Ok(None) => {
                    let idle = async {
                        tokio::select! {
                            () = self.store.inner.work_ready.notified() => {}
                            () = sleep(self.settings.poll) => {}
                        }
                    };
                    unless_phase(&mut self.phase, Phase::Draining, idle).await;
                }
                Err(error) => {
                    tracing::warn!(%error, "no job could be claimed");
                    unless_phase(&mut self.phase, Phase::Draining, backoff.pause()).await;
                }
            }
        }
        given_back
    }

    /// Carries one job to its end; returns whether it was given back instead.
    async fn work_on(&mut self, claim: Claim) -> bool {
        metrics::histogram!("ventricle_job_wait_seconds").record(claim.waited.as_secs_f64());
        let progress = Arc::new(Progress::begin_now());
        let _held = Held::new(&self.store, &claim, &progress);
        let step = Step::begin("input");
        let input = self.input(&claim).await;
        step.end();
        let input = match input {
            Some(Ok(Some(input))) => input,
            Some(Ok(None)) => {
                lost();
                return false;
            }
            Some(Err(error)) => {
                self.finish(&claim, outcome(Err(WorkError::Internal(error.to_string()))), &Snapshot::default()).await;
                return false;
            }
            None => return self.give_back(&claim).await,
        };
        let computed = self.compute(&claim, input, &progress);
        let attended = self.attend(&claim, &progress, computed).await;
        traced::stages(&progress);
        match attended {
            Some(result) => {
                let step = Step::begin("storing");
                self.finish(&claim, outcome(result), &progress.snapshot()).await;
                step.end();
                false
            }
            None if *self.phase.borrow() == Phase::GivingBack => self.give_back(&claim).await,
            None => {
                lost();
                false
            }
        }
    }

    /// Computes on the worker's own thread.
    fn compute(&self, claim: &Claim, input: Vec<u8>, progress: &Arc<Progress>) -> Computed {
        let (work, progress, id, parameters) = (Arc::clone(&self.settings.work), Arc::clone(progress), claim.id, claim.parameters.clone());
        let threads = self.threads(claim);
        tracing::debug!(threads, "computing");
        self.compute.run(threads, move || {
            let internal = |error: &dyn std::fmt::Display| WorkError::Internal(format!("stored job: {error}"));
            let study = input::decode(&input).map_err(|error| internal(&error))?;
            drop(input);
            progress.expect_gates(study.gates.len());
            let parameters = serde_json::from_str(&parameters).map_err(|error| internal(&error))?;
            work(&study, &parameters, id, &progress)
        })
    }

    /// Threads for a job that begins now, beside those that this process holds and those that wait.
    fn threads(&self, claim: &Claim) -> usize {
        let running = self.store.running().len();
        self.settings.threads.of_job(running, claim.others_waiting as usize, self.settings.workers)
    }

    /// Keeps the lease and tells the progress until the work ends; `None` if the lease was lost or is to be given back.
    async fn attend(&mut self, claim: &Claim, progress: &Progress, mut computed: Computed) -> Option<Result<Vec<Output>, WorkError>> {
        let mut ticks = interval(self.settings.progress_interval.min(self.settings.heartbeat));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut told = Snapshot::default();
        let mut next_beat = Instant::now();
        let mut lost = false;
        loop {
            tokio::select! {
                ended = &mut computed => return (!lost).then(|| flatten(ended)),
                _ = ticks.tick(), if !lost => {
                    let now = progress.snapshot();
                    let news = (now != told).then_some(&now);
                    if news.is_none() && Instant::now() < next_beat {
                        continue;
                    }
                    match self.store.heartbeat(claim, news).await {
                        Ok(Heartbeat::Held { cancel }) => {
                            if cancel {
                                progress.cancel();
                            }
                            told = now;
                            next_beat = Instant::now() + self.settings.heartbeat;
                        }
                        Ok(Heartbeat::Lost) => {
                            lost = true;
                            progress.cancel();
                        }
                        Err(error) => {
                            tracing::warn!(%error, "a heartbeat failed");
                            ticks.reset_after(backoff::LONGEST.min(self.settings.heartbeat));
                        }
                    }
                }
                () = reached(&mut self.phase, Phase::GivingBack) => {
                    progress.cancel();
                    let ended = timeout(STOP_GRACE, &mut computed).await.ok().map(flatten);
                    // What ended by itself just now is as good as ever; what was stopped is to be done again.
                    return ended.filter(|result| !lost && !matches!(result, Err(WorkError::Cancelled)));
                }
            }
        }
    }

    /// The stored study, unless the lease was lost; `None` if the store does not answer until the work is to be given back.
    async fn input(&mut self, claim: &Claim) -> Option<Result<Option<Vec<u8>>, StoreError>> {
        let mut backoff = Backoff::default();
        loop {
            match self.store.input(claim).await {
                Err(error) if error.is_passing() => {
                    tracing::warn!(%error, "the input could not be read yet");
                    if !unless_phase(&mut self.phase, Phase::GivingBack, backoff.pause()).await {
                        return None;
                    }
                }
                input => return Some(input),
            }
        }
    }

    /// Stores the end of a job, as soon as the store answers.
    async fn finish(&mut self, claim: &Claim, mut outcome: Outcome, last: &Snapshot) {
        let mut backoff = Backoff::default();
        loop {
            let code = if let Outcome::Failed(error) = &outcome { Some(error.code.clone()) } else { None };
            match self.store.finish(claim, outcome.clone(), last).await {
                Ok(Finish::Done(state)) => {
                    tracing::info!(state = state.name(), "job finished");
                    traced::ended(state.name(), code.filter(|_| state == State::Failed));
                    return;
                }
                Ok(Finish::Lost) => return lost(),
                Err(error) if error.is_passing() => {
                    tracing::warn!(%error, "the end of the job could not be stored yet");
                    if !unless_phase(&mut self.phase, Phase::GivingBack, backoff.pause()).await {
                        return traced::ended_without(Without::Store);
                    }
                }
                Err(error) if matches!(outcome, Outcome::Succeeded(_)) => {
                    tracing::error!(%error, "the results cannot be stored");
                    outcome = Outcome::Failed(internal_error());
                }
                Err(error) => {
                    tracing::error!(%error, "the end of the job cannot be stored; its lease will lapse");
                    return traced::ended_without(Without::Store);
                }
            }
        }
    }

    async fn give_back(&self, claim: &Claim) -> bool {
        match self.store.give_back(claim).await {
            Ok(held) => {
                traced::ended_without(if held { Without::Time } else { Without::Lease });
                held
            }
            Err(error) => {
                tracing::warn!(%error, "the job could not be given back; its lease will lapse");
                traced::ended_without(Without::Store);
                false
            }
        }
    }
}

/// The answer of the computing thread to come.
type Computed = oneshot::Receiver<Result<Result<Vec<Output>, WorkError>, String>>;

/// A job registered as running in this process, so that a request to cancel finds it at once. However the worker leaves it, the
/// computation is told to stop: it has ended, or nobody waits for it.
struct Held {
    store: Store,
    id: uuid::Uuid,
    progress: Arc<Progress>,
}

impl Held {
    fn new(store: &Store, claim: &Claim, progress: &Arc<Progress>) -> Self {
        store.running().insert(claim.id, Arc::clone(progress));
        Self { store: store.clone(), id: claim.id, progress: Arc::clone(progress) }
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.progress.cancel();
        let mut running = self.store.running();
        // Another worker may have claimed the job again after this one lost it.
        if running.get(&self.id).is_some_and(|progress| Arc::ptr_eq(progress, &self.progress)) {
            running.remove(&self.id);
        }
    }
}

fn flatten(ended: Result<Result<Result<Vec<Output>, WorkError>, String>, oneshot::error::RecvError>) -> Result<Vec<Output>, WorkError> {
    match ended {
        Ok(Ok(result)) => result,
        Ok(Err(panic)) => Err(WorkError::Internal(panic)),
        Err(_) => Err(WorkError::Internal("the computing thread is gone".to_owned())),
    }
}

fn outcome(result: Result<Vec<Output>, WorkError>) -> Outcome {
    match result {
        Ok(outputs) => Outcome::Succeeded(outputs.into()),
        Err(WorkError::Cancelled) => Outcome::Cancelled,
        Err(WorkError::Failed { code, message }) => {
            tracing::info!(code, "the study could not be reconstructed");
            Outcome::Failed(JobError { code: code.to_owned(), message })
        }
        Err(WorkError::Internal(error)) => {
            tracing::error!(error, "a job failed inside the service");
            Outcome::Failed(internal_error())
        }
    }
}

/// Tells that another worker has the job, or had it.
fn lost() {
    tracing::warn!("the lease was lost; the work of this attempt is discarded");
    metrics::counter!("ventricle_leases_lost_total").increment(1);
    traced::ended_without(Without::Lease);
}

fn internal_error() -> JobError {
    JobError {
        code: "internal_error".to_owned(),
        message: "The reconstruction failed inside the service. The log has the details under the id of this job.".to_owned(),
    }
}

/// Awaits the future unless the phase is, or meanwhile comes to be, this one or a later one; returns whether it was awaited.
async fn unless_phase(phase: &mut watch::Receiver<Phase>, stop: Phase, future: impl Future<Output = ()>) -> bool {
    tokio::select! {
        () = reached(phase, stop) => false,
        () = future => true,
    }
}

/// Waits for this phase or a later one.
async fn reached(phase: &mut watch::Receiver<Phase>, wanted: Phase) {
    // Without a sender the workers are being dropped and this task with them.
    if phase.wait_for(|phase| *phase >= wanted).await.is_err() {
        std::future::pending::<()>().await;
    }
}
