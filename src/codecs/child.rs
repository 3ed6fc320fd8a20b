//! The child: limits itself, then decodes what it is sent until there is no more.

use super::{decode, protocol};
use std::{
    io::{self, Read, Write},
    panic::{AssertUnwindSafe, catch_unwind},
};

/// Address space of the child: the program itself, and some ten times what the largest frame takes.
#[cfg(unix)]
const ADDRESS_SPACE_BYTES: u64 = 192 << 20;

/// Decodes the frames that arrive, with at most so many seconds of processor time for all of them.
///
/// The limits of the process are set first: memory, processor time, no new files, no core dump. Nothing can raise them again.
///
/// # Errors
/// The limits could not be set, or the parent is gone.
pub fn serve(input: &mut impl Read, output: &mut impl Write, seconds: u64) -> io::Result<()> {
    confine(seconds)?;
    output.write_all(&protocol::READY)?;
    output.flush()?;
    while let Some(request) = protocol::read_request(input)? {
        let decoded = catch_unwind(AssertUnwindSafe(|| decode::samples(request.codec, request.layout, &request.frame)));
        protocol::write_answer(output, &decoded.unwrap_or_else(|_| Err("its decoder met a contradiction".to_owned())))?;
    }
    Ok(())
}

#[cfg(unix)]
fn confine(seconds: u64) -> io::Result<()> {
    use rustix::process::{Resource, Rlimit, setrlimit};
    let limits = [
        (Resource::As, ADDRESS_SPACE_BYTES, ADDRESS_SPACE_BYTES),
        // At the first the process is told to end, at the second it is ended.
        (Resource::Cpu, seconds, seconds + 1),
        (Resource::Fsize, 0, 0),
        (Resource::Nofile, 0, 0),
        (Resource::Core, 0, 0),
    ];
    for (resource, current, maximum) in limits {
        setrlimit(resource, Rlimit { current: Some(current), maximum: Some(maximum) })?;
    }
    Ok(())
}

#[cfg(not(unix))]
fn confine(_seconds: u64) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}
