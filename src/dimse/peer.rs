//! A connection that carries protocol data units (PS3.8 9.3). Their length is judged before anything is allocated, and none may take longer
//! than its time.

use dicom_ul::pdu::{
    AbortRQServiceProviderReason, AbortRQSource, AssociationAC, AssociationRJ, AssociationRQ, PDataValue, PDataValueType, Pdu, read_pdu,
    write_pdu,
};
use std::{collections::VecDeque, io, time::Duration};
use tokio::{
    io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _},
    time::timeout,
};

/// Longest protocol data unit that is accepted, as it is said to the other side.
pub(super) const MOST_PDU_BYTES: u32 = 256 << 10;
/// Bytes before what the length of a unit counts.
const HEADER_BYTES: usize = 6;
/// Bytes of a presentation data value before its data.
const VALUE_HEADER_BYTES: usize = 6;
/// Bytes of a unit where the other side takes any length.
const OWN_PDU_BYTES: usize = 64 << 10;
/// Least a unit must be allowed to have for anything to be sent in it.
const LEAST_PDU_BYTES: usize = 128;
/// Time for what is sent to be taken.
const WRITE_TIME: Duration = Duration::from_secs(30);
/// Time that the other side gets to close the connection, so that it reads what was said last.
const CLOSE_TIME: Duration = Duration::from_secs(2);
/// Most that is read and forgotten meanwhile.
const MOST_FORGOTTEN_BYTES: u64 = 4 << 20;

/// What a connection must be able to do.
pub(super) trait Stream: AsyncRead + AsyncWrite + Unpin + Send {}
impl<S: AsyncRead + AsyncWrite + Unpin + Send> Stream for S {}

/// Why an association cannot go on. Nothing here holds what the other side sent.
#[derive(Debug, thiserror::Error)]
pub enum Broken {
    /// The connection ended.
    #[error("the connection was lost: {0}")]
    Lost(#[from] io::Error),
    /// The other side gave up.
    #[error("the other side aborted the association")]
    Aborted,
    /// Nothing came, or not all of it.
    #[error("nothing more came within {} s", .0.as_secs())]
    Time(Duration),
    /// A unit longer than accepted.
    #[error("a protocol data unit of {length} bytes was announced, at most {MOST_PDU_BYTES} are accepted")]
    TooLong {
        /// Its length.
        length: u32,
    },
    /// What came is no protocol data unit.
    #[error("what came is no protocol data unit of DICOM")]
    Unreadable,
    /// It is one that has no place here.
    #[error("{0} came where it has no place")]
    Unexpected(&'static str),
    /// What is to be sent cannot be.
    #[error("{0}")]
    Unsendable(&'static str),
}

impl Broken {
    /// What the other side is told (PS3.8 table 9-26).
    fn reason(&self) -> AbortRQServiceProviderReason {
        match self {
            Self::Unreadable => AbortRQServiceProviderReason::UnrecognizedPdu,
            Self::Unexpected(_) => AbortRQServiceProviderReason::UnexpectedPdu,
            Self::TooLong { .. } => AbortRQServiceProviderReason::InvalidPduParameter,
            _ => AbortRQServiceProviderReason::ReasonNotSpecified,
        }
    }
}

/// What came.
#[derive(Debug)]
pub(super) enum Event {
    /// A part of a command set or of a data set.
    Value(PDataValue),
    /// The other side wants to end the association.
    Release,
}

/// The other side of a connection.
pub(super) struct Peer<S> {
    stream: S,
    /// Values that came in one unit and were not asked for yet.
    values: VecDeque<PDataValue>,
    /// Longest unit that it takes.
    most_bytes: usize,
}

impl<S: Stream> Peer<S> {
    pub(super) fn new(stream: S) -> Self {
        Self { stream, values: VecDeque::new(), most_bytes: OWN_PDU_BYTES }
    }

    /// Units are sent no longer than the other side says it takes; 0: any.
    pub(super) fn limit(&mut self, most_bytes: u32) {
        self.most_bytes = if most_bytes == 0 { OWN_PDU_BYTES } else { OWN_PDU_BYTES.min(most_bytes as usize) };
    }

    /// The request for an association, which must come first.
    pub(super) async fn request(&mut self, time: Duration) -> Result<AssociationRQ, Broken> {
        match self.read(time).await? {
            Pdu::AssociationRQ(request) => Ok(request),
            Pdu::AbortRQ { .. } => Err(Broken::Aborted),
            _ => Err(Broken::Unexpected("another protocol data unit than A-ASSOCIATE-RQ")),
        }
    }

    /// The answer to a request for an association.
    pub(super) async fn answer(&mut self, time: Duration) -> Result<Result<AssociationAC, AssociationRJ>, Broken> {
        match self.read(time).await? {
            Pdu::AssociationAC(accepted) => Ok(Ok(accepted)),
            Pdu::AssociationRJ(rejected) => Ok(Err(rejected)),
            Pdu::AbortRQ { .. } => Err(Broken::Aborted),
            _ => Err(Broken::Unexpected("another protocol data unit than the answer to A-ASSOCIATE-RQ")),
        }
    }

    /// What comes next in an association.
    pub(super) async fn next(&mut self, time: Duration) -> Result<Event, Broken> {
        loop {
            if let Some(value) = self.values.pop_front() {
                return Ok(Event::Value(value));
            }
            match self.read(time).await? {
                Pdu::PData { data } if !data.is_empty() => self.values.extend(data),
                Pdu::PData { .. } => return Err(Broken::Unexpected("P-DATA-TF without a value")),
                Pdu::ReleaseRQ => return Ok(Event::Release),
                Pdu::AbortRQ { .. } => return Err(Broken::Aborted),
                _ => return Err(Broken::Unexpected("another protocol data unit than data, release or abort")),
            }
        }
    }

    /// The answer to a request to end the association; data that crosses it is forgotten.
    pub(super) async fn released(&mut self, time: Duration) -> Result<(), Broken> {
        loop {
            match self.read(time).await? {
                Pdu::ReleaseRP => return Ok(()),
                Pdu::PData { .. } => {}
                Pdu::AbortRQ { .. } => return Err(Broken::Aborted),
                _ => return Err(Broken::Unexpected("another protocol data unit than A-RELEASE-RP")),
            }
        }
    }

    async fn read(&mut self, time: Duration) -> Result<Pdu, Broken> {
        timeout(time, self.read_whole()).await.unwrap_or(Err(Broken::Time(time)))
    }

    async fn read_whole(&mut self) -> Result<Pdu, Broken> {
        let mut bytes = vec![0; HEADER_BYTES];
        self.stream.read_exact(&mut bytes).await?;
        if !matches!(bytes[0], 1..=7) {
            return Err(Broken::Unreadable);
        }
        let length = u32::from_be_bytes([bytes[2], bytes[3], bytes[4], bytes[5]]);
        if length > MOST_PDU_BYTES {
            return Err(Broken::TooLong { length });
        }
        bytes.resize(HEADER_BYTES + length as usize, 0);
        self.stream.read_exact(&mut bytes[HEADER_BYTES..]).await?;
        match read_pdu(bytes.as_slice(), MOST_PDU_BYTES, true) {
            Ok(Some(pdu)) => Ok(pdu),
            Ok(None) | Err(_) => Err(Broken::Unreadable),
        }
    }

    /// Sends one unit.
    pub(super) async fn write(&mut self, pdu: &Pdu) -> Result<(), Broken> {
        let mut bytes = Vec::new();
        write_pdu(&mut bytes, pdu).map_err(|_| Broken::Unsendable("a protocol data unit cannot be written"))?;
        let writing = async {
            self.stream.write_all(&bytes).await?;
            self.stream.flush().await
        };
        Ok(timeout(WRITE_TIME, writing).await.map_err(|_| Broken::Time(WRITE_TIME))??)
    }

    /// Sends a command set, or a data set, in as many units as it takes.
    pub(super) async fn write_data(&mut self, context: u8, value_type: PDataValueType, data: &[u8]) -> Result<(), Broken> {
        if self.most_bytes < LEAST_PDU_BYTES {
            return Err(Broken::Unsendable("the other side takes protocol data units of less than 128 bytes only"));
        }
        // Of an even length, as every value is.
        let room = (self.most_bytes - VALUE_HEADER_BYTES) & !1;
        let mut rest = data.chunks(room).peekable();
        while let Some(chunk) = rest.next() {
            let value = PDataValue {
                presentation_context_id: context,
                value_type: value_type.clone(),
                is_last: rest.peek().is_none(),
                data: chunk.to_vec(),
            };
            self.write(&Pdu::PData { data: vec![value] }).await?;
        }
        Ok(())
    }

    /// Tells the other side that the association is over, and why, if it still listens.
    pub(super) async fn abort(mut self, broken: &Broken) {
        if matches!(broken, Broken::Lost(_) | Broken::Aborted) {
            return;
        }
        let source = AbortRQSource::ServiceProvider(broken.reason());
        let _ = timeout(CLOSE_TIME, self.write(&Pdu::AbortRQ { source })).await;
        self.close().await;
    }

    /// Lets the other side read what was said last, and close: a connection that is closed over unread bytes is reset, and takes it along.
    pub(super) async fn close(mut self) {
        let closing = async {
            let _ = self.stream.shutdown().await;
            let _ = tokio::io::copy(&mut (&mut self.stream).take(MOST_FORGOTTEN_BYTES), &mut tokio::io::sink()).await;
        };
        let _ = timeout(CLOSE_TIME, closing).await;
    }
}
