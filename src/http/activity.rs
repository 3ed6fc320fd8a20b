//! What goes on over one connection, to know when nothing does: requests that are worked on, answers that are being read.

use axum::{
    body::{Body, Bytes},
    http::Response,
};
use hyper::body::{Frame, SizeHint};
use std::{
    pin::Pin,
    sync::Arc,
    task::{Context, Poll, ready},
    time::Duration,
};
use tokio::{
    sync::watch,
    time::{sleep, timeout},
};

/// Largest piece in which an answer is given to the connection: the next is given once most of this one is written, so that a client which does
/// not read is seen.
const PIECE_BYTES: usize = 128 << 10;

/// How many requests are under way, and of how many the answer is being sent.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Now {
    under_way: usize,
    being_sent: usize,
}

/// What goes on over a connection. Clones are of the same one.
#[derive(Debug, Clone, Default)]
pub(super) struct Activity(Arc<watch::Sender<Now>>);

/// A request that is under way, to the end of its answer.
#[derive(Debug)]
pub(super) struct UnderWay {
    activity: Activity,
    being_sent: bool,
}

impl Activity {
    /// A request begins.
    pub(super) fn begin(&self) -> UnderWay {
        self.0.send_modify(|now| now.under_way += 1);
        UnderWay { activity: self.clone(), being_sent: false }
    }

    /// Returns when there was no request for so long, or when of no answer under way a piece was read for so long. A request that is
    /// worked on may take its time, which has limits of its own.
    pub(super) async fn ended(&self, idle: Duration, stalled: Duration) {
        let mut changes = self.0.subscribe();
        loop {
            let now = *changes.borrow_and_update();
            let patience = match now {
                Now { under_way: 0, .. } => idle,
                Now { under_way, being_sent } if under_way == being_sent => stalled,
                _ => Duration::MAX,
            };
            match timeout(patience, changes.changed()).await {
                Ok(Ok(())) => {}
                // The sender is held here.
                Ok(Err(_)) => return sleep(idle).await,
                Err(_) => return,
            }
        }
    }
}

impl UnderWay {
    /// The answer, under way until its body has ended.
    pub(super) fn answer(mut self, response: Response<Body>) -> Response<Body> {
        self.being_sent = true;
        self.activity.0.send_modify(|now| now.being_sent += 1);
        response.map(|body| Body::new(Sent { body, rest: Bytes::new(), under_way: self }))
    }
}

impl Drop for UnderWay {
    fn drop(&mut self) {
        let being_sent = self.being_sent;
        self.activity.0.send_modify(|now| {
            now.under_way -= 1;
            now.being_sent -= usize::from(being_sent);
        });
    }
}

/// A body that is given in pieces, each of which is a sign of life.
struct Sent {
    body: Body,
    /// What is left of the piece that the inner body gave.
    rest: Bytes,
    under_way: UnderWay,
}

impl hyper::body::Body for Sent {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        if self.rest.is_empty() {
            let Some(frame) = ready!(Pin::new(&mut self.body).poll_frame(context)?) else { return Poll::Ready(None) };
            match frame.into_data() {
                Ok(data) => self.rest = data,
                Err(other) => return Poll::Ready(Some(Ok(other))),
            }
        }
        // Nothing but the time of the last change is told by this.
        self.under_way.activity.0.send_modify(|_| ());
        let length = self.rest.len().min(PIECE_BYTES);
        Poll::Ready(Some(Ok(Frame::data(self.rest.split_to(length)))))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        let (rest, inner) = (self.rest.len() as u64, self.body.size_hint());
        let mut hint = SizeHint::new();
        hint.set_lower(inner.lower().saturating_add(rest));
        if let Some(upper) = inner.upper() {
            hint.set_upper(upper.saturating_add(rest));
        }
        hint
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use http_body_util::BodyExt;

    const NEVER: Duration = Duration::from_hours(1);
    const AT_ONCE: Duration = Duration::from_millis(1);

    /// Whether it is found to have ended; where it is not, that is known after a tenth of a second.
    async fn ends(activity: &Activity, idle: Duration, stalled: Duration) -> bool {
        let patience = if idle == NEVER || stalled == NEVER { 20_000 } else { 100 };
        timeout(Duration::from_millis(patience), activity.ended(idle, stalled)).await.is_ok()
    }

    #[tokio::test]
    async fn idle_and_unread_connections_end_and_those_that_work_do_not() {
        let activity = Activity::default();
        assert!(ends(&activity, AT_ONCE, NEVER).await, "nothing goes on");
        let request = activity.begin();
        assert!(!ends(&activity, AT_ONCE, AT_ONCE).await, "a request is worked on");
        let mut answer = request.answer(Response::new(Body::from(vec![0; 2 * PIECE_BYTES])));
        assert!(ends(&activity, NEVER, AT_ONCE).await, "an answer is not read");
        let other = activity.begin();
        assert!(!ends(&activity, AT_ONCE, AT_ONCE).await, "another request is worked on");
        drop(other);
        let mut changes = activity.0.subscribe();
        answer.body_mut().frame().await.unwrap().unwrap();
        assert!(changes.has_changed().unwrap(), "what is read is a sign of life");
        changes.borrow_and_update();
        drop(answer);
        assert!(changes.has_changed().unwrap() && ends(&activity, AT_ONCE, NEVER).await);
    }

    #[tokio::test]
    async fn an_answer_is_the_same_in_pieces() {
        let bytes: Vec<u8> = (0..3 * PIECE_BYTES + 5).map(|at| at as u8).collect();
        let activity = Activity::default();
        let mut body = activity.begin().answer(Response::new(Body::from(bytes.clone()))).into_body();
        let mut read = Vec::new();
        loop {
            assert_eq!(hyper::body::Body::size_hint(&body).exact(), Some((bytes.len() - read.len()) as u64));
            let Some(frame) = body.frame().await else { break };
            let data = frame.unwrap().into_data().unwrap();
            assert!(data.len() <= PIECE_BYTES);
            read.extend_from_slice(&data);
        }
        assert!(read == bytes && hyper::body::Body::is_end_stream(&body));
        drop(body);
        assert_eq!(*activity.0.borrow(), Now::default());
    }
}
