//! Two jobs set against each other, and the schemas: what is answered, and what is refused.

use super::harness::{Service, failing, idle, working};
use crate::surfaces::{beating, oblique};
use serde_json::{Value, json};
use std::sync::Arc;
use ventricle::{
    analysis::analyse,
    jobs::{Output, Work, WorkError},
    pipeline::parameters::Parameters,
    report::{self, PublishedSchema, Timing},
    study::Study,
};

/// Work that reports two beating ellipsoids, as many gates as the study has; for one with an odd height the report of a version before segments,
/// for one of 2.2 m none.
fn reporting() -> Work {
    Arc::new(|study: &Study, parameters: &Parameters, id, _| {
        let height_m = parameters.metadata.height_m;
        if height_m == Some(2.2) {
            return Err(WorkError::Failed { code: "no_left_ventricle", message: "No left ventricle was found.".into() });
        }
        let (beating, reconstruction) = beating(4 * study.gates.len(), 2, Some(oblique(false)));
        let report = report::build(&id.to_string(), &beating, &reconstruction, &analyse(&beating, &reconstruction), &Timing::default());
        let mut report = json!(report);
        if height_m == Some(1.1) {
            report.as_object_mut().unwrap().remove("regional");
            report["software"]["version"] = json!("0.0.9");
        }
        Ok(vec![Output { name: "report".into(), media_type: "application/json", data: report.to_string().into_bytes() }])
    })
}

async fn finished(service: &Service, seed: u16, height: &str) -> String {
    let study = super::harness::study(seed).to_string();
    let answer = service.post(&format!("?metadata.height_m={height}"), &[("content-type", "application/json")], study).await;
    assert_eq!(answer.status, 202, "{}", answer.json());
    let path = answer.header("location").to_owned();
    service.call("GET", &path, &[("prefer", "wait=20")]).await;
    path
}

fn id(path: &str) -> &str {
    path.rsplit('/').next().unwrap()
}

#[tokio::test]
async fn two_finished_jobs_are_compared() {
    let service = working(reporting()).await;
    let (stress, rest) = (finished(&service, 1, "1.7").await, finished(&service, 2, "1.7").await);
    let path = format!("{stress}/comparison?with={}", id(&rest));
    let answer = service.get(&path).await;
    assert_eq!((answer.status.as_u16(), answer.header("content-type")), (200, "application/json"));
    let comparison = answer.json();
    assert_eq!(comparison["schema"], "ventricle.comparison/1");
    assert_eq!((&comparison["first"]["id"], &comparison["second"]["id"]), (&json!(id(&stress)), &json!(id(&rest))));
    assert_eq!(comparison["tid_ratio"], 1.0);
    assert!(comparison["tid_definition"].as_str().unwrap().contains("all gates"));
    assert_eq!(comparison["ef_percent"]["difference"], 0.0);
    assert_eq!((comparison["segments"].as_array().unwrap().len(), comparison["territories"].as_array().unwrap().len()), (17, 3));
    // Of the fixture's one study.
    assert_eq!(comparison["notes"], json!([]));
    // By its tag, as other results.
    let etag = answer.header("etag").to_owned();
    assert_eq!(service.call("GET", &path, &[("if-none-match", &etag)]).await.status, 304);
    assert_eq!(service.get(&path).await.bytes, answer.bytes);
    service.call("GET", &path, &[("accept", "image/png")]).await.problem(406, "not_acceptable");
    // The other way round is another answer.
    let swapped = service.get(&format!("{rest}/comparison?with={}", id(&stress))).await;
    assert_eq!(swapped.json()["first"]["id"], id(&rest));
    assert_ne!(swapped.header("etag"), etag);
}

#[tokio::test]
async fn what_cannot_be_compared_is_refused_with_what_to_do() {
    let service = working(reporting()).await;
    let stress = finished(&service, 1, "1.7").await;
    for query in ["", "?with=", "?with=7", "?with=rest"] {
        service.get(&format!("{stress}/comparison{query}")).await.problem(400, "invalid_query");
    }
    let nobody = uuid::Uuid::now_v7().to_string();
    service.get(&format!("{stress}/comparison?with={nobody}&colour=red")).await.problem(400, "invalid_query");
    let problem = service.get(&format!("{stress}/comparison?with={nobody}")).await.problem(404, "not_found");
    assert!(problem["detail"].as_str().unwrap().contains(&nobody), "{problem}");
    service.get(&format!("/v1/reconstructions/{nobody}/comparison?with={}", id(&stress))).await.problem(404, "not_found");
    let problem = service.get(&format!("{stress}/comparison?with={}", id(&stress))).await.problem(422, "same_reconstruction");
    assert!(problem["detail"].as_str().unwrap().contains("name another"), "{problem}");
    // A report from before segments.
    let old = finished(&service, 3, "1.1").await;
    for path in [format!("{stress}/comparison?with={}", id(&old)), format!("{old}/comparison?with={}", id(&stress))] {
        let problem = service.get(&path).await.problem(409, "result_too_old");
        let detail = problem["detail"].as_str().unwrap();
        assert!(detail.contains(id(&old)) && detail.contains("0.0.9") && detail.contains("submit"), "{detail}");
    }
    // A job that failed.
    let failed = finished(&service, 4, "2.2").await;
    let problem = service.get(&format!("{stress}/comparison?with={}", id(&failed))).await.problem(409, "reconstruction_failed");
    assert_eq!(problem["cause"]["code"], "no_left_ventricle");
    assert!(problem["detail"].as_str().unwrap().contains(id(&failed)), "{problem}");
}

#[tokio::test]
async fn jobs_that_are_not_finished_are_not_compared() {
    let waiting = idle().await;
    let (one, other) = (waiting.submit(1).await, waiting.submit(2).await);
    let problem = waiting.get(&format!("{one}/comparison?with={}", id(&other))).await.problem(409, "not_finished");
    assert!(problem["detail"].as_str().unwrap().contains(id(&one)), "{problem}");
    let broken = working(failing()).await;
    let (one, other) = (broken.finish(1).await, broken.finish(2).await);
    broken.get(&format!("{one}/comparison?with={}", id(&other))).await.problem(409, "reconstruction_failed");
}

#[tokio::test]
async fn the_schemas_are_served_by_tag() {
    let service = idle().await;
    for schema in PublishedSchema::ALL {
        let path = format!("/schemas/{}.json", schema.name());
        let answer = service.get(&path).await;
        assert_eq!((answer.status.as_u16(), answer.header("content-type")), (200, "application/schema+json"));
        assert_eq!(String::from_utf8(answer.bytes.clone()).unwrap(), schema.document());
        let etag = answer.header("etag").to_owned();
        assert_eq!(service.call("GET", &path, &[("if-none-match", &etag)]).await.status, 304);
    }
    let report: Value = service.get("/schemas/report-1.json").await.json();
    assert_eq!(report["properties"]["schema"]["const"], "ventricle.report/1");
    service.get("/schemas/report-2.json").await.problem(404, "not_found");
}
