//! The file of API keys.
//!
//! One JSON file beside the data, or wherever the operator says: several nodes read the same one, and keys are known while the database is
//! away. `ventricle keys` writes it, as a new file that takes the old one's place; a running service looks every few seconds whether it is
//! another. A file that cannot be read changes nothing: keys stay as they were, and the log says so.

use super::{
    Scope,
    key::{self, Made},
};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::{
    collections::HashMap,
    fs::{self, File, OpenOptions},
    io::{self, Write as _},
    os::unix::fs::{MetadataExt as _, OpenOptionsExt as _},
    path::{Path, PathBuf},
    sync::{Arc, PoisonError, RwLock},
    time::SystemTime,
};
use subtle::ConstantTimeEq as _;

/// What a key may use; what is absent is as the service has it for all.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wished {
    /// Requests a second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub requests_per_second: Option<u32>,
    /// MiB of bodies a day.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mb_per_day: Option<u64>,
    /// Jobs of its owner that may wait.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub queued_jobs: Option<u64>,
}

/// What is kept of a key.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeyRecord {
    /// Names the key, in lists and in the audit log.
    pub id: String,
    /// What it is for, in the operator's words.
    pub note: String,
    /// Whose jobs it makes and sees.
    pub owner: String,
    /// What it may do.
    pub scopes: Vec<Scope>,
    /// SHA-256 of its secret, in hexadecimal digits.
    pub sha256: String,
    /// When it was made.
    pub created_at: Timestamp,
    /// When it ends, if it does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expires_at: Option<Timestamp>,
    /// What it may use.
    #[serde(default)]
    pub limits: Wished,
}

impl KeyRecord {
    /// Whether its time is over.
    pub fn has_expired(&self, now: Timestamp) -> bool {
        self.expires_at.is_some_and(|end| end <= now)
    }
}

/// The file's content.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Content {
    keys: Vec<KeyRecord>,
}

/// Why the file of keys cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum KeyringError {
    /// It is not there or not readable.
    #[error("The file of keys {} cannot be read: {source}. Make one with `ventricle keys add`, or name another with --keys-file.", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// It is not what `ventricle keys` writes.
    #[error("The file of keys {} is not as `ventricle keys` writes it: {source}.", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// Where it is wrong.
        source: serde_json::Error,
    },
    /// It cannot be written.
    #[error("The file of keys {} cannot be written: {source}.", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// There is no such key to revoke.
    #[error("There is no key {id} in {}. `ventricle keys list` shows all.", path.display())]
    NoSuchKey {
        /// The file.
        path: PathBuf,
        /// What was asked for.
        id: String,
    },
    /// The system has no random numbers.
    #[error("The system gives no random numbers, so no key can be made.")]
    Random,
}

/// The keys of a file, as they were when it was last looked at.
pub struct Keyring {
    path: PathBuf,
    loaded: RwLock<Loaded>,
}

struct Loaded {
    keys: HashMap<String, Arc<KeyRecord>>,
    stamp: Stamp,
}

/// What tells one file from the next at the same place.
type Stamp = Option<(SystemTime, u64)>;

impl Keyring {
    /// Reads the file.
    ///
    /// # Errors
    /// It is absent or not understood.
    pub fn open(path: &Path) -> Result<Self, KeyringError> {
        let stamp = stamp(path);
        Ok(Self { path: path.to_owned(), loaded: RwLock::new(Loaded { keys: by_id(read(path)?), stamp }) })
    }

    /// Reads the file again if it is another; returns whether it was.
    ///
    /// # Errors
    /// It is another but cannot be used; keys stay as they were.
    pub fn refresh(&self) -> Result<bool, KeyringError> {
        let stamp = stamp(&self.path);
        if self.loaded.read().unwrap_or_else(PoisonError::into_inner).stamp == stamp {
            return Ok(false);
        }
        let keys = by_id(read(&self.path)?);
        *self.loaded.write().unwrap_or_else(PoisonError::into_inner) = Loaded { keys, stamp };
        Ok(true)
    }

    /// The record of this name.
    pub(super) fn record(&self, id: &str) -> Option<Arc<KeyRecord>> {
        self.loaded.read().unwrap_or_else(PoisonError::into_inner).keys.get(id).cloned()
    }

    /// The records of an owner that are valid, by their names.
    pub(super) fn records_of(&self, owner: &str) -> Vec<Arc<KeyRecord>> {
        let loaded = self.loaded.read().unwrap_or_else(PoisonError::into_inner);
        let now = Timestamp::now();
        loaded.keys.values().filter(|record| record.owner == owner && !record.has_expired(now)).cloned().collect()
    }

    /// The record of a key. It takes as long for a wrong secret as for a right one, and for a name that is unknown.
    pub(super) fn find(&self, text: &str) -> Option<Arc<KeyRecord>> {
        let (id, digest) = key::taken_apart(text)?;
        let record = self.record(id);
        let kept = record.as_ref().map_or_else(|| "0".repeat(digest.len()), |record| record.sha256.clone());
        let right = bool::from(kept.as_bytes().ct_eq(digest.as_bytes()));
        record.filter(|_| right)
    }
}

/// The keys in a file, in the order in which they were made. None where there is no file.
///
/// # Errors
/// It cannot be read.
pub fn list(path: &Path) -> Result<Vec<KeyRecord>, KeyringError> {
    match read(path) {
        Err(KeyringError::Read { source, .. }) if source.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        read => read,
    }
}

/// Adds a key to the file, which is made if it is absent. The key's text is in what is returned, and nowhere else.
///
/// # Errors
/// The file cannot be read or written.
pub fn add(path: &Path, record: impl FnOnce(&Made) -> KeyRecord) -> Result<Made, KeyringError> {
    let made = Made::new().map_err(|_| KeyringError::Random)?;
    let record = record(&made);
    change(path, |keys| {
        keys.push(record);
        Ok(())
    })?;
    Ok(made)
}

/// Takes a key out of the file; returns what it was.
///
/// # Errors
/// There is no such key, or the file cannot be read or written.
pub fn revoke(path: &Path, id: &str) -> Result<KeyRecord, KeyringError> {
    change(path, |keys| {
        let at = keys.iter().position(|key| key.id == id);
        at.map(|at| keys.remove(at)).ok_or_else(|| KeyringError::NoSuchKey { path: path.to_owned(), id: id.to_owned() })
    })
}

/// Changes the file while nobody else does.
fn change<T>(path: &Path, change: impl FnOnce(&mut Vec<KeyRecord>) -> Result<T, KeyringError>) -> Result<T, KeyringError> {
    let failed = |source| KeyringError::Write { path: path.to_owned(), source };
    let beside = |ending: &str| {
        let mut name = path.as_os_str().to_owned();
        name.push(ending);
        PathBuf::from(name)
    };
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(failed)?;
    }
    // Not the file itself, whose place another takes.
    let lock = private(&beside(".lock")).map_err(failed)?;
    lock.lock().map_err(failed)?;
    let mut keys = list(path)?;
    let changed = change(&mut keys)?;
    let written = beside(".new");
    let write = || {
        let mut file = private(&written)?;
        file.set_len(0)?;
        serde_json::to_writer_pretty(&mut file, &Content { keys })?;
        file.write_all(b"\n")?;
        file.sync_all()?;
        fs::rename(&written, path)?;
        path.parent().map_or(Ok(()), |folder| File::open(if folder.as_os_str().is_empty() { Path::new(".") } else { folder })?.sync_all())
    };
    write().map_err(failed)?;
    Ok(changed)
}

/// A file that only its owner reads.
fn private(path: &Path) -> io::Result<File> {
    OpenOptions::new().create(true).write(true).truncate(false).mode(0o600).open(path)
}

fn read(path: &Path) -> Result<Vec<KeyRecord>, KeyringError> {
    let bytes = fs::read(path).map_err(|source| KeyringError::Read { path: path.to_owned(), source })?;
    let content: Content = serde_json::from_slice(&bytes).map_err(|source| KeyringError::Content { path: path.to_owned(), source })?;
    Ok(content.keys)
}

fn by_id(keys: Vec<KeyRecord>) -> HashMap<String, Arc<KeyRecord>> {
    keys.into_iter().map(|key| (key.id.clone(), Arc::new(key))).collect()
}

fn stamp(path: &Path) -> Stamp {
    let metadata = fs::metadata(path).ok()?;
    // A new file has another number, whatever its clock says.
    Some((metadata.modified().ok()?, metadata.ino() ^ metadata.len().rotate_left(32)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder() -> PathBuf {
        let folder = std::env::temp_dir().join(format!("ventricle-keys-{}", uuid::Uuid::now_v7()));
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    fn record(made: &Made) -> KeyRecord {
        KeyRecord {
            id: made.id.clone(),
            note: "a test".to_owned(),
            owner: "hospital".to_owned(),
            scopes: vec![Scope::Read],
            sha256: made.sha256.clone(),
            created_at: Timestamp::now(),
            expires_at: None,
            limits: Wished::default(),
        }
    }

    #[test]
    fn keys_are_found_until_they_are_revoked() {
        let folder = folder();
        let path = folder.join("keys.json");
        assert!(Keyring::open(&path).is_err());
        let (one, two) = (add(&path, record).unwrap(), add(&path, record).unwrap());
        let ring = Keyring::open(&path).unwrap();
        assert_eq!(ring.find(&one.text).unwrap().id, one.id);
        assert!(!ring.refresh().unwrap());
        // One's name with the other's secret.
        let mixed = one.text.replace(&one.id, &two.id);
        assert!(ring.find(&mixed).is_none() && ring.find("ventricle_000000000000_x").is_none() && ring.find("").is_none());
        revoke(&path, &one.id).unwrap();
        assert!(ring.refresh().unwrap());
        assert!(ring.find(&one.text).is_none());
        assert_eq!(ring.find(&two.text).unwrap().id, two.id);
        assert!(matches!(revoke(&path, &one.id), Err(KeyringError::NoSuchKey { .. })));
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_broken_file_leaves_the_keys_as_they_were_and_only_its_owner_reads_it() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = folder();
        let path = folder.join("keys.json");
        let made = add(&path, record).unwrap();
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        assert!(!fs::read_to_string(&path).unwrap().contains(made.text.rsplit('_').next().unwrap()));
        let ring = Keyring::open(&path).unwrap();
        fs::write(&path, "{\"keys\": [").unwrap();
        assert!(matches!(ring.refresh(), Err(KeyringError::Content { .. })));
        assert!(ring.find(&made.text).is_some());
        fs::remove_file(&path).unwrap();
        assert!(matches!(ring.refresh(), Err(KeyringError::Read { .. })));
        assert!(ring.find(&made.text).is_some());
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn several_writers_lose_no_key() {
        let folder = folder();
        let path = folder.join("keys.json");
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| add(&path, record).unwrap());
            }
        });
        assert_eq!(list(&path).unwrap().len(), 8);
        fs::remove_dir_all(&folder).unwrap();
    }
}
