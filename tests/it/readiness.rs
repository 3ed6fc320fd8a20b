//! A database that answers and cannot be written: the service calls itself not ready, and ready again once it can.

use crate::{
    cluster::Cluster,
    served::{Directory, Served},
};
use serde_json::Value;
use sqlx::{Connection as _, Executor as _, PgConnection};
use std::{
    process::Command,
    time::{Duration, Instant},
};

/// How long a change may take to be told: what was found is believed for 5 s.
const SOON: Duration = Duration::from_secs(30);

/// Waits until the line of the database says this.
fn until_told(service: &Served, ok: bool, status: u16) -> Value {
    let began = Instant::now();
    loop {
        let answer = service.get("/readyz");
        let store = answer.json()["checks"]["store"].clone();
        if store["ok"] == ok {
            assert_eq!(answer.status, status, "{store}");
            return store;
        }
        assert!(began.elapsed() < SOON, "{store}");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// Files of the service may not grow from now on, its log among them, or may again. The soft limit only, which anybody may raise again.
fn limit_files(service: &Served, limit: &str) {
    let status = Command::new("prlimit").args(["--pid", &service.id().to_string(), &format!("--fsize={limit}:")]).status().unwrap();
    assert!(status.success(), "{status}");
}

#[test]
fn an_embedded_database_that_takes_no_writes_makes_the_service_not_ready() {
    let data = Directory::new("unwritable");
    // The signal that would end a program whose file reaches the limit is ignored, so that it gets an error as from a full disk.
    let mut command = Command::new("bash");
    command.args(["-c", "trap '' XFSZ; exec \"$@\"", "bash", env!("CARGO_BIN_EXE_ventricle")]);
    command.args(["serve", "--listen", "127.0.0.1:0", "--log", "warn", "--data-dir"]).arg(&data.0);
    command.stderr(std::fs::File::create(data.0.join("log")).unwrap());
    let service = Served::start_by(command, &[]);
    assert_eq!(service.get("/readyz").status, 200);
    limit_files(&service, "1");
    let told = until_told(&service, false, 503);
    assert!(told["detail"].as_str().unwrap().contains("takes nothing that is written"), "{told}");
    assert_eq!(service.get("/v1/reconstructions").status, 200, "it can be read");
    assert_eq!(service.get("/healthz").status, 200);
    limit_files(&service, "unlimited");
    until_told(&service, true, 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_of_nodes_that_takes_no_writes_makes_them_not_ready() {
    let Some(cluster) = Cluster::start("nodes on a database that cannot be written") else { return };
    let data = Directory::new("unwritable-node");
    let service = Served::start(&data.0, &["--database-url", &cluster.url]);
    assert_eq!(service.get("/readyz").status, 200);
    let mut operator = PgConnection::connect(&cluster.url).await.unwrap();
    // As after a failover to a replica, or by an operator who wants nothing changed.
    operator.execute("ALTER SYSTEM SET default_transaction_read_only = on").await.unwrap();
    operator.execute("SELECT pg_reload_conf()").await.unwrap();
    let told = until_told(&service, false, 503);
    assert!(told["detail"].as_str().unwrap().contains("takes nothing that is written"), "{told}");
    operator.execute("SET default_transaction_read_only = off").await.unwrap();
    operator.execute("ALTER SYSTEM RESET default_transaction_read_only").await.unwrap();
    operator.execute("SELECT pg_reload_conf()").await.unwrap();
    until_told(&service, true, 200);
    // Writes that are accepted and never end, as with a synchronous replica that is gone. A row that another node holds is none of that.
    let mut holder = operator.begin().await.unwrap();
    holder.execute("SELECT version FROM schema_version FOR UPDATE").await.unwrap();
    std::thread::sleep(Duration::from_secs(6));
    assert_eq!(service.get("/readyz").status, 200);
    holder.execute("LOCK TABLE schema_version IN EXCLUSIVE MODE").await.unwrap();
    until_told(&service, false, 503);
    holder.rollback().await.unwrap();
    until_told(&service, true, 200);
}
