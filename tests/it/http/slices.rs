//! Contours on slices, the counts under them, and the few numbers that a list shows.

use super::{
    archived::{beating, dicom, reconstructing, result},
    harness::{Service, failing, idle, with, working},
};
use crate::surfaces;
use serde_json::{Value, json};
use std::sync::Arc;
use ventricle::{
    analysis::analyse,
    config::Cors,
    jobs::{Output, StoreSettings, Work},
    phantom,
    report::Slices,
};

/// Submits a file and waits for its job to succeed.
async fn reconstructed(service: &Service, query: &str, file: Vec<u8>) -> Value {
    let accepted = service.post(query, &[], file).await;
    assert_eq!(accepted.status, 202, "{}", accepted.json());
    let job = accepted.json();
    assert_eq!((&job["input_kept"], &job["summary"]), (&json!(true), &Value::Null), "it waits, and has its input");
    for _ in 0..20 {
        let job = service.call("GET", accepted.header("location"), &[("prefer", "wait=30")]).await.json();
        if job["state"] == "succeeded" {
            return job;
        }
        assert_ne!(job["state"], "failed", "{job}");
    }
    panic!("it did not end");
}

/// Width, height and grey levels of a PNG picture.
fn grey(png: &[u8]) -> (usize, usize, Vec<u8>) {
    let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().unwrap();
    let mut data = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut data).unwrap();
    assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Grayscale, png::BitDepth::Eight));
    (info.width as usize, info.height as usize, data)
}

fn plane<'a>(slices: &'a Value, name: &str) -> &'a Value {
    slices["planes"].as_array().unwrap().iter().find(|plane| plane["plane"] == name).unwrap()
}

/// The lines of one surface in one slice.
fn lines(slice: &Value, surface: &str) -> Vec<Vec<[f64; 2]>> {
    serde_json::from_value(slice[surface].clone()).unwrap()
}

/// Area inside closed lines in pixels.
fn area(lines: &[Vec<[f64; 2]>]) -> f64 {
    let twice = |line: &Vec<[f64; 2]>| line.windows(2).map(|w| w[0][0] * w[1][1] - w[1][0] * w[0][1]).sum::<f64>().abs();
    lines.iter().map(twice).sum::<f64>() / 2.0
}

/// Volume in ml inside the lines of a surface over parallel slices.
fn volume_ml(plane: &Value, gate: usize, surface: &str) -> f64 {
    let pixel: [f64; 2] = serde_json::from_value(plane["pixel_mm"].clone()).unwrap();
    let slices = plane["gates"][gate]["slices"].as_array().unwrap();
    let pixels: f64 = slices.iter().map(|slice| area(&lines(slice, surface))).sum();
    pixels * pixel[0] * pixel[1] * plane["slice_mm"].as_f64().unwrap() / 1000.0
}

/// Mean grey level on the way between neighbouring points of two lines, and at the middle of the inner one.
fn wall_and_cavity(picture: &[u8], (width, height): (usize, usize), slice: usize, contours: &Value) -> (f64, f64) {
    let level = |[x, y]: [f64; 2]| f64::from(picture[(slice * height + y.round() as usize) * width + x.round() as usize]);
    let (inner, outer) = (&lines(contours, "endocardial")[0], &lines(contours, "epicardial")[0]);
    let middle = inner.iter().fold([0.0; 2], |sum, point| [sum[0] + point[0], sum[1] + point[1]]).map(|sum| sum / inner.len() as f64);
    let near = |point: &[f64; 2]| {
        let distance = |other: &&[f64; 2]| (point[0] - other[0]).hypot(point[1] - other[1]);
        outer.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap()
    };
    let between = inner.iter().map(|point| {
        let other = near(point);
        level([f64::midpoint(point[0], other[0]), f64::midpoint(point[1], other[1])])
    });
    (between.sum::<f64>() / inner.len() as f64, level(middle))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn contours_enclose_the_volumes_of_the_report_and_lie_on_the_wall() {
    let service = reconstructing(false).await;
    let job = reconstructed(&service, "?keep_input=true", dicom(&beating())).await;
    let path = job["links"]["self"].as_str().unwrap().to_owned();
    assert_eq!((&job["input_kept"], &job["links"]["slices"]), (&json!(true), &json!(format!("{path}/slices"))));
    let report = service.get(&format!("{path}/report")).await.json();
    let expected = json!({
        "edv_ml": report["function"]["edv_ml"], "esv_ml": report["function"]["esv_ml"], "ef_percent": report["function"]["ef_percent"],
        "mass_g": report["myocardium"]["mass_g"], "quality_score": report["quality"]["score"], "flags": report["quality"]["flags"],
    });
    assert_eq!(job["summary"], expected);
    assert_eq!(service.get("/v1/reconstructions").await.json()["reconstructions"][0]["summary"], expected);

    let answer = result(&service, &format!("{path}/slices"), "application/json").await;
    let slices = answer.json();
    assert_eq!((&slices["schema"], &slices["id"], &slices["gates"]), (&json!("ventricle.slices/1"), &job["id"], &json!(4)));
    let unchanged = service.call("GET", &format!("{path}/slices"), &[("if-none-match", answer.header("etag"))]).await;
    assert_eq!((unchanged.status.as_u16(), unchanged.bytes.len()), (304, 0));
    for name in ["short_axis", "acquired"] {
        for gate in 0..4 {
            for surface in ["endocardial", "epicardial"] {
                let told = report["gates"][gate][format!("{surface}_ml")].as_f64().unwrap();
                let summed = volume_ml(plane(&slices, name), gate, surface);
                assert!((summed / told - 1.0).abs() < 0.05, "{name}, gate {}, {surface}: {summed} of {told} ml", gate + 1);
            }
        }
    }
    let labels = |left: &str, right: &str, top: &str, bottom: &str| json!({"left": left, "right": right, "top": top, "bottom": bottom});
    let short = plane(&slices, "short_axis");
    assert_eq!(short["labels"], labels("septal", "lateral", "anterior", "inferior"));
    let views = &plane(&slices, "long_axis")["views"];
    assert_eq!((&views[0]["view"], &views[0]["labels"]), (&json!("horizontal"), &labels("septal", "lateral", "apex", "base")));
    assert_eq!((&views[1]["view"], &views[1]["labels"]), (&json!("vertical"), &labels("inferior", "anterior", "apex", "base")));
    let axis: [f64; 3] = serde_json::from_value(report["pose"]["axis"].clone()).unwrap();
    let through: [f64; 3] = serde_json::from_value(short["through"].clone()).unwrap();
    assert!((0..3).all(|i| (axis[i] - through[i]).abs() < 1e-9), "the apex first");
    let acquired = plane(&slices, "acquired");
    let grid = json!([acquired["slices"], acquired["height"], acquired["width"]]);
    assert_eq!((grid, &acquired["origin_mm"]), (report["study"]["grid"]["shape"].clone(), &json!([0.0, 0.0, 0.0])));

    for (name, query) in [("short_axis", ""), ("long_axis", "?plane=long_axis"), ("acquired", "?plane=acquired")] {
        let told = plane(&slices, name);
        let (width, height, count) = (
            told["width"].as_u64().unwrap() as usize,
            told["height"].as_u64().unwrap() as usize,
            told["slices"].as_u64().unwrap() as usize,
        );
        for gate in 1..=4 {
            let address = format!("{path}/gates/{gate}/slices.png{query}");
            let picture = result(&service, &address, "image/png").await;
            let (pixels_across, pixels_down, levels) = grey(&picture.bytes);
            assert_eq!((pixels_across, pixels_down), (width, height * count), "{name}");
            let middle = if name == "long_axis" { 0 } else { count / 2 };
            let contours = &told["gates"][gate - 1]["slices"][middle];
            let (wall, cavity) = wall_and_cavity(&levels, (width, height), middle, contours);
            assert!(wall > 90.0 && wall > 1.5 * cavity, "{name}, gate {gate}: wall {wall}, cavity {cavity}");
            let again = service.call("GET", &address, &[("if-none-match", picture.header("etag"))]).await;
            assert_eq!(again.status, 304);
        }
    }
    // Untouched: the brightest pixels of all gates are white or as bright as the file says.
    let study = phantom::simulate(&beating()).unwrap().study;
    let (_, _, levels) = grey(&service.get(&format!("{path}/gates/2/slices.png?plane=acquired")).await.bytes);
    let white = slices["white_counts"].as_f64().unwrap();
    for (level, count) in levels.iter().zip(study.gates[1].volume.counts.iter()) {
        assert_eq!(*level, (f64::from(*count) / white * 255.0).round().min(255.0) as u8);
    }
    service.get(&format!("{path}/gates/5/slices.png")).await.problem(404, "no_such_result");
    service.get(&format!("{path}/gates/0/slices.png")).await.problem(404, "no_such_result");
    let problem = service.get(&format!("{path}/gates/1/slices.png?plane=coronal")).await.problem(400, "invalid_query");
    assert!(problem["detail"].as_str().unwrap().contains("`short_axis`, `long_axis`, `acquired`"), "{problem}");
    service.get(&format!("{path}/gates/1/slices.png?gate=2")).await.problem(400, "invalid_query");
    let png_only = [("accept", "image/png")];
    service.call("GET", &format!("{path}/slices"), &png_only).await.problem(406, "not_acceptable");
}

/// Work that gives the slices of a beating ellipsoid of two gates at once.
fn sliced() -> Work {
    Arc::new(|_, _, id, _| {
        let (study, found) = surfaces::beating(2, 2, None);
        let slices = Slices::of(&id.to_string(), &study, &found, &analyse(&study, &found));
        Ok(vec![Output { name: "slices".into(), media_type: "application/json", data: serde_json::to_vec(&slices).unwrap() }])
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn contours_outlive_the_input_and_the_counts_do_not() {
    let service = working(sliced()).await;
    let path = service.finish(0).await;
    assert_eq!(service.get(&path).await.json()["input_kept"], false);
    let slices = service.get(&format!("{path}/slices")).await;
    assert_eq!((slices.status.as_u16(), &plane(&slices.json(), "short_axis")["labels"]), (200, &Value::Null), "walls are not known");
    let problem = service.get(&format!("{path}/gates/1/slices.png")).await.problem(409, "input_not_kept");
    let detail = problem["detail"].as_str().unwrap();
    assert!(detail.contains("`keep_input`") && detail.contains("--keep-input"), "{detail}");
    service.get(&format!("{path}/gates/3/slices.png")).await.problem(404, "no_such_result");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_page_of_another_site_can_read_slices() {
    let origin = "https://viewer.example";
    let settings = StoreSettings { keep_input: true, ..StoreSettings::default() };
    let service = with(settings, Some(sliced()), |state| state.with_cors(Cors::Origins(vec![origin.into()]))).await;
    let path = service.finish(0).await;
    for name in ["slices", "gates/1/slices.png"] {
        let answer = service.call("GET", &format!("{path}/{name}"), &[("origin", origin)]).await;
        assert_eq!((answer.status.as_u16(), answer.header("access-control-allow-origin")), (200, origin), "{name}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn without_a_result_there_are_no_slices() {
    let waiting = idle().await;
    let failed = working(failing()).await;
    let old = working(super::harness::instant()).await;
    let (queued, lost, done) = (waiting.submit(0).await, failed.finish(0).await, old.finish(0).await);
    for name in ["slices", "gates/1/slices.png"] {
        waiting.get(&format!("{queued}/{name}")).await.problem(409, "not_finished");
        failed.get(&format!("{lost}/{name}")).await.problem(409, "reconstruction_failed");
        old.get(&format!("{done}/{name}")).await.problem(404, "no_such_result");
        waiting.get(&format!("/v1/reconstructions/{}/{name}", uuid::Uuid::nil())).await.problem(404, "not_found");
    }
    assert_eq!(failed.get(&lost).await.json()["summary"], Value::Null);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_built_in_phantom_is_a_study_as_any_other() {
    let service = idle().await;
    let file = result(&service, "/v1/phantom.dcm", "application/dicom").await;
    let expected = phantom::dicom::write(&phantom::simulate(&phantom::Phantom::demo()).unwrap().study).unwrap();
    assert_eq!(file.bytes, expected, "what `ventricle demo` posts");
    let unchanged = service.call("GET", "/v1/phantom.dcm", &[("if-none-match", file.header("etag"))]).await;
    assert_eq!((unchanged.status.as_u16(), unchanged.bytes.len()), (304, 0));
    let accepted = service.post("", &[], file.bytes).await;
    assert_eq!((accepted.status.as_u16(), &accepted.json()["progress"]["gates_total"]), (202, &json!(8)));
}
