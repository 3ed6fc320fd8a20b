//! `ventricle decode-frames`: the child process that decodes compressed images. Not for people.

use std::io;
use ventricle::codecs;

/// Arguments of `ventricle decode-frames`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Processor time for everything it is sent, in s.
    #[arg(long)]
    seconds: u64,
}

/// Decodes what it is sent.
pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    Ok(codecs::serve(&mut io::stdin().lock(), &mut io::stdout().lock(), args.seconds)?)
}
