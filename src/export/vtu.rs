//! The wall of a gate as tetrahedra in a VTK XML file (`UnstructuredGrid`), for `ParaView`, `meshio` and other readers of VTK.
//!
//! Points are in mm along the patient's axes (LPS) when the study has an orientation, else along the grid's; the field data
//! `in_patient_frame` (1 or 0) and a comment say which. A string would be plainer, but `meshio` reads no file that holds one. Unlike in the
//! glTF no axis is turned up and nothing is moved to the origin. The vertices of the endocardial surface come first,
//! then those of the epicardial one in the same order.
//!
//! | data | on | what |
//! |---|---|---|
//! | `thickness_mm` | points | distance to the closest point of the other surface ([`crate::pipeline::thickness`]) |
//! | `surface` | points | 0 endocardial, 1 epicardial |
//! | `lid` | points | 1 in the valve plane, where the thickness is nominal |
//! | `displacement_mm` | points | the vertex's motion since the end-diastolic gate, three components |
//! | `volume_mm3` | cells | volume of the tetrahedron |
//!
//! Arrays are little-endian, each one zlib block in base64 (VTK file formats, "XML file formats"): the file stays well-formed XML, and
//! at 2562 vertices .5 MB a gate, six tenths of what it is uncompressed.

use super::{ExportError, frame::SceneFrame};
use crate::{
    mesh::wall::signed_volume_mm3,
    pipeline::{GateReconstruction, Reconstruction, Surface, thickness::Thickness},
    study::Study,
};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use flate2::{Compression, write::ZlibEncoder};
use glam::DVec3;
use std::io::{self, Write as _};

/// `VTK_TETRA`.
const TETRAHEDRON: u8 = 10;

/// The wall of one gate (counted from 0).
pub fn wall(study: &Study, reconstruction: &Reconstruction, gate: usize) -> Result<Vec<u8>, ExportError> {
    let gates = reconstruction.gates.len();
    let shown = reconstruction.gates.get(gate).ok_or(ExportError::NoSuchGate { gate: gate + 1, gates })?;
    let wall = shown.wall().ok_or(ExportError::NoWall { gate: gate + 1 })?;
    let frame = SceneFrame { orientation: study.orientation, centre_m: DVec3::ZERO };
    for surface in Surface::BOTH {
        if !shown.fits.get(surface).mesh.positions.iter().all(|position| position.is_finite()) {
            return Err(ExportError::NotFinite { gate: gate + 1, surface });
        }
    }
    let points: Vec<DVec3> = wall.positions.iter().map(|&position| frame.mm(position)).collect();
    let tetrahedra: Vec<[u32; 4]> =
        wall.tetrahedra.iter().map(|&[a, b, c, d]| if frame.mirrors() { [b, a, c, d] } else { [a, b, c, d] }).collect();
    let volumes: Vec<f64> = tetrahedra.iter().map(|cell| signed_volume_mm3(cell.map(|vertex| points[vertex as usize]))).collect();
    let diastole = end_diastole(reconstruction).unwrap_or(shown).wall().filter(|other| other.positions.len() == points.len());
    let diastole = diastole.ok_or(ExportError::Topology { gate: gate + 1, surface: Surface::Endocardial })?;
    let displacements: Vec<DVec3> = diastole.positions.iter().zip(&points).map(|(&from, to)| to - frame.mm(from)).collect();
    let thickness = Thickness::of(shown, reconstruction.to_base);
    let inner_count = shown.fits.endocardial.mesh.positions.len();

    let mut file = File(String::new());
    let (point_count, cell_count) = (points.len(), tetrahedra.len());
    let axes = if study.orientation.is_some() { "the patient: left, back, head (LPS)" } else { "the grid: columns, rows, slices" };
    file.line("<?xml version=\"1.0\"?>");
    file.line(concat!("<!-- ventricle ", env!("CARGO_PKG_VERSION"), " -->"));
    file.line(&format!("<!-- gate {}; mm along the axes of {axes} -->", gate + 1));
    file.line(
        "<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt32\" \
         compressor=\"vtkZLibDataCompressor\">",
    );
    file.line("<UnstructuredGrid>\n<FieldData>");
    file.tuples("in_patient_frame", "Int32", 0, " NumberOfTuples=\"1\"", &u32::from(study.orientation.is_some()).to_le_bytes())?;
    file.tuples("gate", "Int32", 0, " NumberOfTuples=\"1\"", &(gate as u32 + 1).to_le_bytes())?;
    file.line("</FieldData>");
    file.line(&format!("<Piece NumberOfPoints=\"{point_count}\" NumberOfCells=\"{cell_count}\">\n<Points>"));
    file.array("Points", "Float64", 3, &reals(points.iter().flat_map(DVec3::to_array)))?;
    file.line("</Points>\n<Cells>");
    file.array("connectivity", "Int32", 0, &integers(tetrahedra.iter().flatten().copied()))?;
    file.array("offsets", "Int32", 0, &integers((1..=cell_count).map(|cell| 4 * cell as u32)))?;
    file.array("types", "UInt8", 0, &vec![TETRAHEDRON; cell_count])?;
    file.line("</Cells>\n<PointData Scalars=\"thickness_mm\" Vectors=\"displacement_mm\">");
    let thickness_mm = Surface::BOTH.into_iter().flat_map(|surface| thickness.mm.get(surface).iter().copied());
    file.array("thickness_mm", "Float32", 0, &singles(thickness_mm))?;
    file.array("surface", "UInt8", 0, &(0..point_count).map(|vertex| u8::from(vertex >= inner_count)).collect::<Vec<_>>())?;
    let in_lid = Surface::BOTH.into_iter().flat_map(|surface| thickness.in_lid.get(surface).iter().map(|&in_lid| u8::from(in_lid)));
    file.array("lid", "UInt8", 0, &in_lid.collect::<Vec<_>>())?;
    file.array("displacement_mm", "Float32", 3, &singles(displacements.iter().flat_map(DVec3::to_array)))?;
    file.line("</PointData>\n<CellData Scalars=\"volume_mm3\">");
    file.array("volume_mm3", "Float64", 0, &reals(volumes.iter().copied()))?;
    file.line("</CellData>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>");
    Ok(file.0.into_bytes())
}

/// The gate of the largest cavity, the first of equals, as in the report.
fn end_diastole(reconstruction: &Reconstruction) -> Option<&GateReconstruction> {
    let larger = |best: &'_ GateReconstruction, gate: &GateReconstruction| {
        gate.volume_ml(Surface::Endocardial) > best.volume_ml(Surface::Endocardial)
    };
    reconstruction.gates.iter().reduce(|best, gate| if larger(best, gate) { gate } else { best })
}

fn reals(values: impl Iterator<Item = f64>) -> Vec<u8> {
    values.flat_map(f64::to_le_bytes).collect()
}

fn singles(values: impl Iterator<Item = f64>) -> Vec<u8> {
    values.flat_map(|value| (value as f32).to_le_bytes()).collect()
}

fn integers(values: impl Iterator<Item = u32>) -> Vec<u8> {
    values.flat_map(u32::to_le_bytes).collect()
}

/// The text of the file so far.
struct File(String);

impl File {
    fn line(&mut self, line: &str) {
        self.0.push_str(line);
        self.0.push('\n');
    }

    /// An array of a value a point or cell, or of `components` (0: a scalar).
    fn array(&mut self, name: &str, kind: &str, components: usize, bytes: &[u8]) -> io::Result<()> {
        self.tuples(name, kind, components, "", bytes)
    }

    fn tuples(&mut self, name: &str, kind: &str, components: usize, more: &str, bytes: &[u8]) -> io::Result<()> {
        let components = if components > 0 { format!(" NumberOfComponents=\"{components}\"") } else { String::new() };
        // Coordinates hardly compress and indices easily do: the highest level makes the file no smaller than the fastest.
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
        encoder.write_all(bytes)?;
        let compressed = encoder.finish()?;
        // One block, its length, no shorter last block, its compressed length.
        let head = integers([1, bytes.len() as u32, 0, compressed.len() as u32].into_iter());
        let data = STANDARD.encode(head) + &STANDARD.encode(compressed);
        self.line(&format!("<DataArray type=\"{kind}\" Name=\"{name}\"{components}{more} format=\"binary\">{data}</DataArray>"));
        Ok(())
    }
}
