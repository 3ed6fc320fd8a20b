//! PostgreSQL away for longer than a lease, and PostgreSQL that takes nothing that is written.

use super::{
    QUICK, alone,
    faults::{accepted, assert_finished, assert_refused, say, some_accepted, until_ready, until_told},
    study,
};
use crate::{
    cluster::Cluster,
    served::{Directory, Served},
};
use sqlx::{Connection as _, Executor as _, PgConnection};
use std::{thread, time::Duration};

const LEASE: &str = "4";
/// Longer than a lease.
const AWAY: Duration = Duration::from_secs(7);

fn start(data: &Directory, cluster: &Cluster) -> Served {
    Served::start(&data.0, &["--database-url", &cluster.url, "--workers", "1", "--lease-seconds", LEASE])
}

#[test]
fn a_database_that_is_away_loses_nothing() {
    let _alone = alone();
    let Some(cluster) = Cluster::start("a database that is away") else { return };
    let data = Directory::new("database-away");
    let mut service = start(&data, &cluster);
    until_ready(&service);
    let mut ids = some_accepted(&service);
    cluster.halt();
    let told = until_told(&service, "store", false);
    assert_refused(&service.post_with(QUICK, "application/dicom", &study()), "store_unavailable");
    assert_eq!(service.get("/healthz").status, 200);
    thread::sleep(AWAY);
    assert!(service.is_alive());
    cluster.resume();
    until_ready(&service);
    ids.push(accepted(&service, QUICK));
    let attempts = assert_finished(&service, &ids);
    assert_eq!(attempts, ids.len() as u64, "no attempt is charged for a database");
    say("PostgreSQL away", &told, ids.len(), attempts);
}

#[tokio::test(flavor = "multi_thread")]
#[expect(clippy::await_holding_lock, reason = "the test has the machine to itself, all its way")]
async fn a_database_that_is_read_only_loses_nothing() {
    let _alone = alone();
    let Some(cluster) = Cluster::start("a database that is read-only") else { return };
    let data = Directory::new("database-read-only");
    let mut service = start(&data, &cluster);
    until_ready(&service);
    let mut ids = some_accepted(&service);
    let mut operator = PgConnection::connect(&cluster.url).await.unwrap();
    operator.execute("ALTER SYSTEM SET default_transaction_read_only = on").await.unwrap();
    operator.execute("SELECT pg_reload_conf()").await.unwrap();
    let told = until_told(&service, "store", false);
    assert_refused(&service.post_with(QUICK, "application/dicom", &study()), "store_unavailable");
    assert_eq!(service.get("/v1/reconstructions").status, 200, "it can be read");
    assert_eq!(service.get("/healthz").status, 200);
    thread::sleep(AWAY);
    assert_eq!(service.get("/v1/reconstructions?state=failed").json()["reconstructions"], serde_json::json!([]));
    operator.execute("SET default_transaction_read_only = off").await.unwrap();
    operator.execute("ALTER SYSTEM RESET default_transaction_read_only").await.unwrap();
    operator.execute("SELECT pg_reload_conf()").await.unwrap();
    until_ready(&service);
    ids.push(accepted(&service, QUICK));
    let attempts = assert_finished(&service, &ids);
    assert_eq!(attempts, ids.len() as u64, "no attempt is charged for a database");
    assert!(service.is_alive());
    say("PostgreSQL read-only", &told, ids.len(), attempts);
}
