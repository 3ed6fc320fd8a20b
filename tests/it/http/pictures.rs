//! Polar maps as numbers and pictures, and the page: what they hold, what they leave out, and whether they print on one sheet.

use super::{
    archived::{beating, contains, dicom, reconstructed, reconstructing, result},
    harness::{Service, failing, idle, working},
};
use crate::shared::absent;
use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::{
    path::{Path, PathBuf},
    process::Command,
    time::Instant,
};
use ventricle::{
    archive::{
        Finished,
        page::{self, Parts},
    },
    phantom::{self, Phantom, anatomy::Defect, anatomy::Site},
    report::{PolarMaps, Quantity, Report},
};

/// Where pictures are kept to be looked at.
fn kept(name: &str, bytes: &[u8]) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("pictures");
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

/// Width, height and pixels of a PNG picture.
fn pixels(png: &[u8]) -> (usize, usize, Vec<u8>) {
    let mut decoder = png::Decoder::new(std::io::Cursor::new(png));
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().unwrap();
    let mut data = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut data).unwrap();
    assert_eq!(info.color_type, png::ColorType::Rgb);
    (info.width as usize, info.height as usize, data)
}

/// Opens no element that it does not close.
fn assert_nested(svg: &str) {
    let mut open: Vec<&str> = Vec::new();
    for tag in svg.split('<').skip(1) {
        let (tag, _) = tag.split_once('>').expect("a tag ends");
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name));
        } else if !tag.ends_with('/') {
            open.push(tag.split_whitespace().next().unwrap());
        }
    }
    assert!(open.is_empty(), "{open:?}");
}

/// A ventricle that takes up less at one wall.
fn with_defect() -> Phantom {
    let mut phantom = beating();
    phantom.uptake.defects = vec![Defect { site: Site::Inferior, extent: 0.18, severity: 0.7 }];
    phantom
}

/// The maps as numbers agree with the report, and show the defect where it is.
fn assert_maps(maps: &Value, report: &Value) {
    assert_eq!((&maps["schema"], &maps["id"]), (&"ventricle.polar-maps/1".into(), &report["id"]));
    assert_eq!((&maps["rings"], &maps["sectors"]), (&20.into(), &60.into()));
    assert_eq!(maps["rotation"], report["regional"]["rotation"]);
    let list = maps["maps"].as_array().unwrap();
    let names: Vec<&str> = list.iter().map(|map| map["quantity"].as_str().unwrap()).collect();
    assert_eq!(names, Quantity::ALL.map(Quantity::name));
    for (map, member) in list.iter().zip([
        "perfusion_percent",
        "end_diastolic_thickness_mm",
        "end_systolic_thickness_mm",
        "thickening_percent",
        "motion_mm",
        "phase_degrees",
    ]) {
        let values = map["values"].as_array().unwrap();
        assert!(values.len() == 20 && values.iter().all(|ring| ring.as_array().unwrap().len() == 60));
        for (mean, segment) in map["segments"].as_array().unwrap().iter().zip(report["regional"]["segments"].as_array().unwrap()) {
            assert_eq!(*mean, segment[member], "{member}");
        }
    }
    // Mid inferior (sector 30 is 183°) against mid anterior.
    let at = |sector: usize| list[0]["values"][12][sector].as_f64().unwrap();
    assert!(at(30) < 0.75 * at(0), "{} of {}", at(30), at(0));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn polar_maps_and_the_page_show_what_was_found_and_nobodys_name() {
    let service = reconstructing(true).await;
    let path = reconstructed(&service, dicom(&with_defect())).await;
    let job = service.get(&path).await.json();
    assert_eq!(job["links"]["polar_maps"], format!("{path}/polar-maps"));
    assert_eq!(job["links"]["page"], format!("{path}/report.html"));
    let report = service.get(&format!("{path}/report")).await.json();
    let maps = result(&service, &format!("{path}/polar-maps"), "application/json").await;
    assert_maps(&maps.json(), &report);

    for quantity in Quantity::ALL {
        let name = quantity.name();
        let png = result(&service, &format!("{path}/polar-maps/{name}.png"), "image/png").await;
        let (width, height, rgb) = pixels(&png.bytes);
        assert_eq!((width, height), (900, 800));
        kept(&format!("{name}.png"), &png.bytes);
        if quantity == Quantity::Perfusion {
            // The disc has its middle at (384, 432) and the radius 290: the inferior wall is darker than the anterior.
            let light = |x: usize, y: usize| rgb[3 * (y * width + x)..][..3].iter().map(|&byte| u32::from(byte)).sum::<u32>();
            let around = |y: usize| (370..398).map(|x| light(x, y)).sum::<u32>() / 28;
            assert!(around(432 + 145 + 12) + 80 < around(432 - 145 - 12), "{} {}", around(589), around(275));
        }
        let svg = result(&service, &format!("{path}/polar-maps/{name}.svg"), "image/svg+xml").await;
        assert!(svg.header("content-security-policy").contains("img-src data:;"));
        let text = String::from_utf8(svg.bytes.clone()).unwrap();
        assert_nested(&text);
        assert!(text.contains("<title ") && text.contains("<desc ") && text.contains("anterior"), "{text}");
        assert!(!text.contains("href=\"http") && !text.contains("<script"));
        kept(&format!("{name}.svg"), &svg.bytes);
    }

    let began = Instant::now();
    let page = result(&service, &format!("{path}/report.html"), "text/html; charset=utf-8").await;
    println!("the page took {:?} and has {} bytes", began.elapsed(), page.bytes.len());
    let html = String::from_utf8(page.bytes.clone()).unwrap();
    assert_page(&html, page.header("content-security-policy"), &report);
    assert!(contains(&dicom(&with_defect()), phantom::dicom::PATIENT_NAME.as_bytes()), "or else the next line shows nothing");
    assert!(!contains(&page.bytes, phantom::dicom::PATIENT_NAME.as_bytes()) && !html.contains("PHANTOM"));
    assert_prints_on_one_sheet("report", &html);

    for name in ["polar-maps", "polar-maps/phase.png", "polar-maps/motion.svg", "report.html"] {
        let address = format!("{path}/{name}");
        let (first, again) = (service.get(&address).await, service.get(&address).await);
        assert!(first.bytes == again.bytes && first.header("etag") == again.header("etag"), "{name} differs from itself");
        let unchanged = service.call("GET", &address, &[("if-none-match", first.header("etag"))]).await;
        assert_eq!((unchanged.status.as_u16(), unchanged.bytes.len()), (304, 0));
        service.call("GET", &address, &[("accept", "model/gltf-binary")]).await.problem(406, "not_acceptable");
    }
    for wrong in ["volume.png", "perfusion.gif", "perfusion", "png", ".png"] {
        let problem = service.get(&format!("{path}/polar-maps/{wrong}")).await.problem(404, "no_such_result");
        assert!(problem["detail"].as_str().unwrap().contains("end_diastolic_thickness"), "{problem}");
    }
    assert_old_and_odd_reports_have_a_page(&service, &path).await;
}

/// Self-contained, allowed by its own policy, and with the report's numbers.
fn assert_page(html: &str, policy: &str, report: &Value) {
    let (_, rest) = html.split_once("<style>").unwrap();
    let (style, _) = rest.split_once("</style>").unwrap();
    let hash = STANDARD.encode(Sha256::digest(style));
    assert!(policy.contains("default-src 'none'") && policy.contains(&format!("style-src 'sha256-{hash}'")), "{policy}");
    assert!(!policy.contains("unsafe"), "{policy}");
    for forbidden in ["<script", "<link", " style=", " onload", "href=\"http", "src=\"http", "url(", "@import"] {
        assert!(!html.contains(forbidden), "{forbidden} is in the page");
    }
    assert!(html.split("src=\"").skip(1).all(|source| source.starts_with("data:image/png;base64,")));
    let rounded = |pointer: &str, decimals: usize| format!("<td>{:.decimals$}</td>", report.pointer(pointer).unwrap().as_f64().unwrap());
    for (name, value) in [
        ("EF", rounded("/function/ef_percent", 0)),
        ("EDV", rounded("/function/edv_ml", 0)),
        ("ESV", rounded("/function/esv_ml", 0)),
        ("Wall mass", rounded("/myocardium/mass_g", 0)),
        ("Peak filling rate", rounded("/cycle/peak_filling_rate_edv_per_s", 2)),
        ("Extent", rounded("/perfusion/extent_percent", 0)),
        ("Bandwidth 95 %", rounded("/phase/bandwidth_95_degrees", 0)),
    ] {
        assert!(html.contains(&format!("<td>{name}</td>{value}")), "{name} {value}");
    }
    for text in [
        "Not reviewed by a physician",
        "not a medical device",
        "preset clinical",
        report["study"]["study_instance_uid"].as_str().unwrap(),
        report["software"]["version"].as_str().unwrap(),
    ] {
        assert!(html.to_lowercase().contains(&text.to_lowercase()), "{text}");
    }
    assert_eq!(html.matches("<svg").count(), 8, "curve, histogram and six maps");
    assert_eq!(html.matches("<img").count(), 4, "two views of both ends");
    for warning in report["warnings"].as_array().unwrap() {
        let message = warning["message"].as_str().unwrap();
        assert!(html.contains(&ventricle::drawing::svg::escaped(message)), "{message}");
    }
}

/// What Chromium prints.
fn assert_prints_on_one_sheet(name: &str, html: &str) {
    for size in ["A4", "letter"] {
        let sized = html.replacen("@page { margin", &format!("@page {{ size: {size}; margin"), 1);
        assert_ne!(sized, html);
        let page = kept(&format!("{name}-{size}.html"), sized.as_bytes());
        let pdf = page.with_extension("pdf");
        let profile = page.with_extension("profile");
        let command = Command::new("chromium")
            .args(["--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer"])
            .arg(format!("--user-data-dir={}", profile.display()))
            .arg(format!("--print-to-pdf={}", pdf.display()))
            .arg(format!("file://{}", page.display()))
            .output();
        let Ok(output) = command else { return absent("chromium") };
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let bytes = std::fs::read(&pdf).unwrap();
        let pages = bytes.windows(11).filter(|window| window.starts_with(b"/Type /Page") && window.len() == 11).count()
            - bytes.windows(12).filter(|window| *window == b"/Type /Pages").count();
        assert_eq!(pages, 1, "{name} on {size}: {}", pdf.display());
        std::fs::remove_dir_all(profile).unwrap();
    }
}

/// Reports of before the polar maps, with many warnings, without a model: still a page, and one.
async fn assert_old_and_odd_reports_have_a_page(service: &Service, path: &str) {
    let report: Report = serde_json::from_slice(&service.get(&format!("{path}/report")).await.bytes).unwrap();
    let maps: PolarMaps = serde_json::from_slice(&service.get(&format!("{path}/polar-maps")).await.bytes).unwrap();
    let surfaces = service.get(&format!("{path}/surfaces.glb")).await.bytes;
    let id = path.rsplit('/').next().unwrap().parse().unwrap();
    let mut finished = Finished { id, finished_at: "2026-01-02T03:04:05Z".parse().unwrap(), report, subject: None };
    for number in 0..40 {
        let message = format!("Warning {number} & <b>what</b> it means: {}.", "something long to read about the wall ".repeat(3));
        finished.report.warnings.push(ventricle::report::Remark { code: "x".to_owned(), message, gate: Some(3), affected: None });
    }
    finished.report.study.study_instance_uid = Some("1.2.<i>3</i>".to_owned());
    let parts = Parts { maps: Some(&maps), surfaces: &surfaces };
    let html = page::write(&finished, &parts).unwrap();
    assert!(
        html.contains("1.2.&lt;i&gt;3&lt;/i&gt;") && html.contains("&amp; &lt;b&gt;what") && html.contains("more in the report as JSON")
    );
    assert_prints_on_one_sheet("many", &html);

    let old = &mut finished.report;
    old.warnings.clear();
    (old.regional, old.perfusion, old.phase, old.shape, old.cycle, old.model, old.uncertainty) = (None, None, None, None, None, None, None);
    let html = page::write(&finished, &Parts { maps: None, surfaces: &surfaces }).unwrap();
    assert!(html.contains("before polar maps were kept") && html.contains("No warnings") && html.contains("<td>EDV</td>"));
    assert!(page::write(&finished, &Parts { maps: None, surfaces: b"glTF" }).is_err());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_ungated_study_has_perfusion_and_thickness_and_its_page_says_so() {
    let service = reconstructing(false).await;
    let mut still = Phantom::demo();
    still.imaging.gates = 1;
    still.imaging.oriented = false;
    let path = reconstructed(&service, phantom::nifti::write(&phantom::simulate(&still).unwrap().study)).await;
    let maps = service.get(&format!("{path}/polar-maps")).await.json();
    let names: Vec<&str> = maps["maps"].as_array().unwrap().iter().map(|map| map["quantity"].as_str().unwrap()).collect();
    assert_eq!(names, ["perfusion", "end_diastolic_thickness"]);
    assert_eq!(maps["rotation"]["source"], "assumed");
    let svg = service.get(&format!("{path}/polar-maps/perfusion.svg")).await.bytes;
    assert!(contains(&svg, b"Rotation unknown"));
    for absent in ["motion.png", "phase.svg", "thickening.png"] {
        let problem = service.get(&format!("{path}/polar-maps/{absent}")).await.problem(404, "no_such_result");
        assert!(problem["detail"].as_str().unwrap().contains("Maps are perfusion, end_diastolic_thickness,"), "{problem}");
    }
    let page = service.get(&format!("{path}/report.html")).await;
    let html = String::from_utf8(page.bytes).unwrap();
    assert!(html.contains("Fewer than four gates") && html.contains("rotation is not known") && html.contains("<td>Cavity</td>"));
    assert_eq!((html.matches("<svg").count(), html.matches("<img").count()), (2, 2));
    assert_prints_on_one_sheet("ungated", &html);
}

#[tokio::test]
async fn what_is_not_finished_or_has_failed_has_no_pictures() {
    let waiting = idle().await;
    let path = waiting.submit(1).await;
    let broken = working(failing()).await;
    let failed = broken.finish(1).await;
    for name in ["polar-maps", "polar-maps/perfusion.png", "polar-maps/phase.svg", "polar-maps/volume.png", "report.html"] {
        waiting.get(&format!("{path}/{name}")).await.problem(409, "not_finished");
        broken.get(&format!("{failed}/{name}")).await.problem(409, "reconstruction_failed");
        waiting.get(&format!("/v1/reconstructions/{}/{name}", uuid::Uuid::now_v7())).await.problem(404, "not_found");
    }
}
