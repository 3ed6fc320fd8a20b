//! The paper's tables and figures: what follows from the printed numbers, what `docs/paper.md` says against what the code gives, and
//! Table 1's claim.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use std::{fs, path::Path};
use ventricle::{
    drawing::markdown,
    paper::{self, figures, initial_meshes, models, printed},
    pipeline::parameters::Model,
};

fn document() -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/paper.md")).unwrap()
}

#[test]
fn the_printed_table_5_gives_its_ejection_fraction_and_walls() {
    let function = printed::cycle_function().unwrap();
    assert_eq!(format!("{:.1}", function.ef_percent), printed::EJECTION_FRACTION_PERCENT.to_string());
    assert_eq!((function.end_diastolic_gate, function.end_systolic_gate), (7, 4));
    for (computed, printed) in printed::cycle_wall_mm3().into_iter().zip(printed::CYCLE_WALL_MM3) {
        assert!((computed - printed).abs() < 0.5, "{computed} {printed}");
    }
}

#[test]
fn the_printed_dimensions_do_not_give_the_printed_volumes() {
    /// The π with which the printed external volume comes out to its decimal.
    const PRINTED_PI: f64 = 31_415.0 / 10_000.0;
    // The solids that the figures could mean, with each printed radius and height.
    for radius in [printed::R1_MM, printed::R2_MM, printed::R3_MM] {
        let volume = printed::capped_cylinder_mm3(radius, printed::H_MM);
        for printed in [printed::INTERNAL_MM3, printed::EXTERNAL_MM3] {
            assert!((volume / printed - 1.0).abs() > 0.01, "{radius}: {volume}");
        }
    }
    // What does give them: a hemisphere of R2, and R2's capped cylinder of height 56 with the paper's π.
    let hemisphere = printed::capped_cylinder_mm3(printed::R2_MM, 0.0);
    assert!((hemisphere - printed::INTERNAL_MM3).abs() < 4.0, "{hemisphere}");
    let with_printed_pi = printed::capped_cylinder_mm3(printed::R2_MM, 56.0) / std::f64::consts::PI * PRINTED_PI;
    assert!((with_printed_pi - printed::EXTERNAL_MM3).abs() < 0.1, "{with_printed_pi}");
    assert_eq!(format!("{:.1}", printed::thresholded_excess_percent()), "20.8");
}

#[test]
fn table_6_follows_from_its_volumes_but_for_one_rounding() {
    for row in &printed::MISSING {
        let percent = row.recovered_percent();
        assert!((percent - row.of_total_percent).abs() < 0.06, "{percent} {}", row.of_total_percent);
        let Some(printed) = row.relative_error else { continue };
        let computed = printed::relative_error(row.emptied_percent, percent);
        // .2500 is printed as .24.
        assert!((computed - printed).abs() < 0.011, "{computed} {printed}");
    }
}

#[test]
fn the_document_s_table_2_is_what_the_code_gives() {
    let now = initial_meshes::markdown(&initial_meshes::measure().unwrap());
    assert_eq!(markdown::written(&document(), "table 2"), Some(now.trim()), "run make tables");
}

#[test]
fn every_table_and_figure_has_its_place_in_the_document() {
    let document = document();
    for number in paper::TABLES {
        let written = markdown::written(&document, &format!("table {number}")).unwrap_or_default();
        assert!(written.lines().filter(|line| line.starts_with('|')).count() > 3, "table {number}: {written}");
    }
    for number in figures::FIGURES {
        assert!(document.contains(&format!("](paper/figure-{number}.svg)")), "figure {number}");
    }
}

/// Table 1 from outside the border at a fraction of its cost: explicit steps of .01 s instead of .0005 s, plane steps of .05 s.
#[test]
fn the_free_model_is_first_and_within_a_voxel() {
    let steps = models::Steps { plane_1_s: 0.05, plane_2_s: 0.05, explicit_s: 0.01 };
    let tried = ["Plane (2)", "Spring-mass", "Free"];
    let candidates: Vec<_> = models::candidates(&steps).into_iter().filter(|one| tried.contains(&one.name)).collect();
    let rows = models::measure_from(true, &candidates).unwrap();
    let within = |model: Model| {
        let of: Vec<f64> =
            rows.iter().filter(|row| row.candidate.parameters.deform.model == model).map(|row| row.run.within_one_voxel).collect();
        assert_eq!(of.len(), 2, "{model:?}: a row a surface");
        of
    };
    let mean = |model: Model| within(model).iter().sum::<f64>() / 2.0;
    assert!(within(Model::Free).iter().all(|&part| part >= 0.97), "{:?}", within(Model::Free));
    for other in [Model::Plane, Model::SpringMass] {
        assert!(mean(Model::Free) > mean(other), "{other:?}: {} against {}", mean(other), mean(Model::Free));
    }
}

/// Every picture in a sheet decodes, and is not of one colour.
fn check_sheet(name: &str, svg: &str) {
    assert!(svg.starts_with("<svg xmlns=") && svg.ends_with("</svg>\n"), "{name}");
    assert!(svg.len() < 300_000, "{name}: {} bytes", svg.len());
    // Without the pictures, in whose letters anything may occur.
    let drawn: String = svg.split("base64,").map(|part| part.split_once('"').map_or(part, |(_, rest)| rest)).collect();
    assert!(!drawn.contains("NaN") && !drawn.contains("inf"), "{name}");
    assert!(svg.matches("<text").count() >= 4, "{name}");
    let pictures: Vec<&str> = svg.split("base64,").skip(1).map(|rest| rest.split('"').next().unwrap()).collect();
    for picture in &pictures {
        let bytes = STANDARD.decode(picture).unwrap();
        let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
        decoder.set_transformations(png::Transformations::EXPAND);
        let mut reader = decoder.read_info().unwrap();
        let mut data = vec![0; reader.output_buffer_size().unwrap()];
        let used = reader.next_frame(&mut data).unwrap().buffer_size();
        assert!(data[..used].chunks_exact(3).any(|pixel| pixel != &data[..3]), "{name}: an empty picture");
    }
    let lines = svg.matches("<polyline").count();
    assert!(!pictures.is_empty() || lines > 20, "{name}: {} pictures, {lines} lines", pictures.len());
}

#[test]
fn committed_figures_are_valid_and_not_empty() {
    for number in figures::FIGURES {
        let name = format!("figure-{number}.svg");
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/paper").join(&name);
        check_sheet(&name, &fs::read_to_string(path).unwrap());
    }
}

#[test]
fn figures_of_operators_and_borders_can_be_drawn() {
    for number in [6, 7] {
        let figure = figures::figure(number).unwrap().unwrap();
        check_sheet(figure.file, &figure.svg);
    }
    assert!(figures::figure(9).unwrap().is_none(), "figure 9 is a formula");
}
