//! `ventricle keys`: makes, lists and revokes API keys. A running service follows within seconds.

use anyhow::{Context as _, bail};
use jiff::{SignedDuration, Timestamp};
use std::{io::Write as _, path::PathBuf};
use ventricle::{
    access::{self, AuditFile, Deed, KeyRecord, Scope, Wished},
    config::{default_keys_file, owner},
};

/// Most days of a key that ends: ten years.
const MOST_DAYS: u32 = 3650;

/// Arguments of `ventricle keys`.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    place: Place,
}

/// Where the keys are, as `ventricle serve` reads it.
#[derive(clap::Args)]
struct Place {
    /// The file of keys [default: `keys.json` in the data directory].
    #[arg(long, env = "VENTRICLE_KEYS_FILE", global = true)]
    keys_file: Option<PathBuf>,

    /// Data directory of the service.
    #[arg(long, env = "VENTRICLE_DATA_DIR", default_value = "./data", global = true)]
    data_dir: PathBuf,

    /// The audit log of the service, which is told of keys that are made and revoked.
    #[arg(long, env = "VENTRICLE_AUDIT_LOG", global = true)]
    audit_log: Option<PathBuf>,

    /// Prints JSON.
    #[arg(long, global = true)]
    json: bool,
}

impl Place {
    fn file(&self) -> PathBuf {
        self.keys_file.clone().unwrap_or_else(|| default_keys_file(&self.data_dir))
    }

    /// The audit log, opened before anything is done that it is to tell of.
    fn audit(&self) -> Result<Option<AuditFile>, access::AuditError> {
        self.audit_log.as_deref().map(AuditFile::open).transpose()
    }
}

#[derive(clap::Subcommand)]
enum Command {
    /// Makes a key and prints it, once.
    Add(Add),
    /// Lists the keys, without their secrets, which nobody has.
    List,
    /// Revokes a key.
    Revoke {
        /// Its id, as the list shows it: the twelve digits after `ventricle_`.
        id: String,
    },
}

#[derive(clap::Args)]
struct Add {
    /// Whose jobs it makes and sees. Keys of one owner share their jobs; `anonymous` are those that came before there were keys.
    #[arg(long, value_parser = owner)]
    owner: String,

    /// What it may do, separated by commas: `submit` (send studies, cancel and delete jobs), `read` (jobs and results), `admin` (both, and metrics).
    #[arg(long, value_delimiter = ',', default_value = "submit,read", value_parser = scope)]
    scope: Vec<Scope>,

    /// What it is for, in your words.
    #[arg(long, default_value = "")]
    note: String,

    /// Days after which it ends by itself.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=i64::from(MOST_DAYS)))]
    expires_days: Option<u32>,

    /// Requests a second [default: as the service has it for all; 0: no limit].
    #[arg(long)]
    requests_per_second: Option<u32>,

    /// MiB of bodies a day [default: as the service has it for all; 0: no limit].
    #[arg(long, value_parser = clap::value_parser!(u64).range(0..=1_073_741_824))]
    mb_per_day: Option<u64>,

    /// Jobs of its owner that may wait [default: as the service has it for all; 0: as many as of all].
    #[arg(long)]
    queued_jobs: Option<u64>,
}

fn scope(text: &str) -> Result<Scope, String> {
    Scope::from_name(text).ok_or_else(|| format!("there are {}.", Scope::ALL.map(Scope::name).join(", ")))
}

/// Does what is asked with the file of keys.
pub(crate) fn run(Args { command, place }: Args) -> anyhow::Result<()> {
    let file = place.file();
    match command {
        Command::Add(asked) => add(asked, &place, &file),
        Command::List => list(&place, &file),
        Command::Revoke { id } => {
            let audit = place.audit()?;
            let revoked = access::revoke(&file, &id)?;
            println!("{} of {} is revoked.", revoked.id, revoked.owner);
            tell(audit, "keys revoke", revoked.owner, revoked.id)
        }
    }
}

/// Tells the audit log, if there is one, of what was done with a key, and by which user of the system.
fn tell(audit: Option<AuditFile>, what: &str, owner: String, key: String) -> anyhow::Result<()> {
    let Some(mut audit) = audit else { return Ok(()) };
    let who = format!("uid {}", rustix::process::getuid().as_raw());
    let deed = Deed { owner: Some(owner), who: Some(who), key: Some(key), ..Deed::now(what) };
    audit.add(&deed).context("It is done, but the audit log could not be told of it")
}

fn add(asked: Add, place: &Place, file: &std::path::Path) -> anyhow::Result<()> {
    let Add { owner, mut scope, note, expires_days, requests_per_second, mb_per_day, queued_jobs } = asked;
    if note.chars().any(char::is_control) {
        bail!("The note holds control characters.");
    }
    scope.sort_unstable();
    scope.dedup();
    let audit = place.audit()?;
    let first = !file.exists();
    let created_at = Timestamp::now();
    let expires_at = expires_days.map(|days| created_at + SignedDuration::from_hours(24 * i64::from(days)));
    let limits = Wished { requests_per_second, mb_per_day, queued_jobs };
    let made = access::add(file, |made| KeyRecord {
        id: made.id.clone(),
        note,
        owner: owner.clone(),
        scopes: scope,
        sha256: made.sha256.clone(),
        created_at,
        expires_at,
        limits,
    })?;
    if place.json {
        println!("{}", serde_json::json!({ "id": made.id, "owner": owner, "key": made.text, "expires_at": expires_at }));
        return tell(audit, "keys add", owner, made.id);
    }
    println!("{}", made.text);
    // Beside the output, which may be on its way into a file.
    let mut said = std::io::stderr();
    writeln!(said, "This is the only time that the key is shown. {} has its digest.", file.display())?;
    if first {
        writeln!(said, "It is the first: a service that runs already asks for keys from its next start on.")?;
    }
    tell(audit, "keys add", owner, made.id)
}

fn list(place: &Place, file: &std::path::Path) -> anyhow::Result<()> {
    let keys = access::list(file)?;
    if place.json {
        // Digests of random secrets tell nothing, but nobody needs them either.
        let shown = |key: &KeyRecord| {
            serde_json::json!({
                "id": key.id, "owner": key.owner, "scopes": key.scopes, "note": key.note, "created_at": key.created_at,
                "expires_at": key.expires_at, "limits": key.limits,
            })
        };
        println!("{}", keys.iter().map(shown).collect::<serde_json::Value>());
        return Ok(());
    }
    let now = Timestamp::now();
    println!("{:<12}  {:<20}  {:<18}  {:<20}  {:<20}  note", "id", "owner", "scopes", "made", "ends");
    for key in keys {
        let scopes = key.scopes.iter().map(|scope| scope.name()).collect::<Vec<_>>().join(",");
        let ends = match key.expires_at {
            None => "never".to_owned(),
            Some(at) if at <= now => format!("ended {at:.0}"),
            Some(at) => format!("{at:.0}"),
        };
        println!(
            "{:<12}  {:<20}  {:<18}  {:<20.0}  {:<20}  {}",
            key.id,
            key.owner,
            scopes,
            format!("{:.0}", key.created_at),
            ends,
            key.note
        );
    }
    Ok(())
}
