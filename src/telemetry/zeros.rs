//! Counters that rules for alerts look at, begun at zero with the process: Prometheus sees a rise from zero, but not one from nothing.

/// Begins them.
pub(super) fn begin() {
    metrics::counter!("ventricle_leases_lost_total").increment(0);
    for state in ["queued", "failed", "cancelled"] {
        metrics::counter!("ventricle_jobs_reaped_total", "state" => state).increment(0);
    }
    for state in ["succeeded", "failed", "cancelled"] {
        metrics::counter!("ventricle_jobs_finished_total", "state" => state).increment(0);
    }
    for code in ["internal_error", "worker_lost", "export_failed", "no_left_ventricle"] {
        metrics::counter!("ventricle_jobs_failed_total", "code" => code).increment(0);
    }
    metrics::counter!("ventricle_http_problems_total", "code" => "internal_error").increment(0);
    for direction in ["forward", "back"] {
        metrics::counter!("ventricle_clock_set_total", "direction" => direction).increment(0);
    }
    for operation in ["claim", "heartbeat", "submit", "finish", "read"] {
        metrics::counter!("ventricle_store_failures_total", "operation" => operation).increment(0);
    }
    for outcome in ["delivered", "failed", "refused", "given_up"] {
        metrics::counter!("ventricle_callbacks_total", "outcome" => outcome).increment(0);
        metrics::counter!("ventricle_results_sent_total", "outcome" => outcome).increment(0);
    }
}
