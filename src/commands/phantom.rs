//! `ventricle phantom`: simulated studies as files.

use anyhow::Context;
use clap::ValueEnum;
use std::path::PathBuf;
use std::str::FromStr;
use ventricle::phantom::{self, Defect, Liver, Phantom, Psf, Regional, Shape, Simulation, Site, Tail, Ventricle};
use ventricle::volume::Grid;

const EXAMPLES: &str = "\
Examples:
  A normal ventricle as DICOM, with its truth:
    ventricle phantom -o normal.dcm --truth normal.json
  The test object of García and Susín's paper as NIfTI:
    ventricle phantom --preset paper --format nifti -o paper.nii
  A dilated heart with a large inferior defect beside a hot liver, 16 gates, 6.4 mm voxels, tilted:
    ventricle phantom --preset dilated --defect inferior:0.32:0.9 --liver 5:1.5 --gates 16 \\
      --grid 64x64x24 --spacing 6.4x6.4x6.4 --tilt 15,-10 -o hard.dcm
  A given volume and ejection fraction, without noise, blurred by 14 mm:
    ventricle phantom --edv 160 --ef 45 --fwhm 14 --noise-free --format nifti-gz -o known.nii.gz
  A septal sector of 60° that contracts a quarter of the cycle late, beside an akinetic apex:
    ventricle phantom --preset normal --regional septal:width=60:delay=90 --regional all:to=0.3:amplitude=0 -o late.dcm

Each gate is the heart at the gate's centre (or the mean of --phases of it), so the gates' own ejection fraction is a little below that of the
continuous cycle: .60 becomes .565 with 8 gates and .595 with 16. The truth is the gates' own. The same arguments give the same file.";

/// Arguments of `ventricle phantom`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    #[command(flatten)]
    options: Box<Options>,
}

#[derive(clap::Args)]
struct Options {
    /// What to start from; every option below changes one thing about it
    #[arg(long, value_enum, default_value_t = Preset::Demo)]
    preset: Preset,
    /// Where to write the study
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// The file's format
    #[arg(long, value_enum, default_value_t = FileFormat::Dicom)]
    format: FileFormat,
    /// Where to write the exact volumes, landmarks and all parameters, as JSON
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,

    #[command(flatten, next_help_heading = "Shape")]
    shape: ShapeArgs,
    #[command(flatten, next_help_heading = "Place and deformation (volumes stay exact)")]
    place: PlaceArgs,
    #[command(flatten, next_help_heading = "Uptake (fractions of a normal wall)")]
    uptake: UptakeArgs,
    #[command(flatten, next_help_heading = "Imaging")]
    imaging: ImagingArgs,
}

#[derive(Clone, Copy, ValueEnum)]
enum Preset {
    /// A normal ventricle as a clinic might see it: slightly tilted and oval, uneven uptake, right ventricle, noise
    Demo,
    /// The paper's test object: cylinders with hemispherical caps, 89.794 and 305.31 ml, static, one gate, 8 mm PSF, no noise
    Paper,
    /// A still ventricle of 265.501 ml outside, for the paper's missing data (add --defect): one gate, 8 mm PSF, no noise
    HeartLike,
    /// EDV 120 ml, EF .60
    Normal,
    /// EDV 250 ml, EF .25
    Dilated,
    /// EDV 45 ml, EF .80
    Small,
    /// Normal, with a bent axis
    Bent,
    /// Normal, with an oval section that turns from apex to base
    Twisted,
    /// No ventricle at all: background and noise
    Empty,
}

#[derive(Clone, Copy, ValueEnum)]
enum FileFormat {
    /// DICOM Nuclear Medicine Image Storage, RECON GATED TOMO (RECON TOMO for one gate), 16 bits
    Dicom,
    /// NIfTI-1, 32-bit floats, dimensions x, y, z, gate
    Nifti,
    /// The same, gzipped
    NiftiGz,
}

#[derive(clap::Args)]
struct ShapeArgs {
    /// Cavity at end diastole of the continuous cycle, in ml
    #[arg(long, value_name = "ML")]
    edv: Option<f64>,
    /// Cavity at end systole of the continuous cycle, in ml
    #[arg(long, value_name = "ML", conflicts_with = "ef")]
    esv: Option<f64>,
    /// Ejection fraction of the continuous cycle, in percent (instead of --esv)
    #[arg(long, value_name = "PERCENT")]
    ef: Option<f64>,
    /// Wall volume, the same at every gate, in ml
    #[arg(long, value_name = "ML")]
    wall: Option<f64>,
    /// Length of the cavity over its diameter at end diastole
    #[arg(long, value_name = "RATIO")]
    elongation: Option<f64>,
    /// Shortening from apex to base, as a fraction of the cavity's length
    #[arg(long, value_name = "FRACTION")]
    shortening: Option<f64>,
    /// A part of the wall with a function of its own: its middle (anterior, septal, inferior, lateral, all, or degrees from anterior over septal),
    /// then any of width and edge (degrees; 60 and 20), from and to (parts of the height, 0 tip to 1 base), delay (degrees of the cycle), amplitude
    /// (1 as the rest, 0 akinetic), thickness (1 as the rest); repeatable, a later one over an earlier one
    #[arg(long, value_name = "MIDDLE[:KEY=VALUE]...", value_parser = regional)]
    regional: Vec<Regional>,
    /// Inner and outer radius of the paper's object, in mm
    #[arg(long, value_name = "INNER,OUTER", value_parser = list::<f64, 2>)]
    radii: Option<[f64; 2]>,
    /// Inner and outer height of the paper's object without the caps, in mm
    #[arg(long, value_name = "INNER,OUTER", value_parser = list::<f64, 2>)]
    heights: Option<[f64; 2]>,
}

#[derive(clap::Args)]
#[command(allow_negative_numbers = true)]
struct PlaceArgs {
    /// Tilt about the grid's x and y axes, in degrees
    #[arg(long, value_name = "X,Y", value_parser = list::<f64, 2>, allow_hyphen_values = true)]
    tilt: Option<[f64; 2]>,
    /// Displacement from the grid's centre, in mm (x lateral, y inferior, z to the base)
    #[arg(long, value_name = "X,Y,Z", value_parser = list::<f64, 3>, allow_hyphen_values = true)]
    offset: Option<[f64; 3]>,
    /// Basal slice first
    #[arg(long)]
    reversed: bool,
    /// Sideways displacement of apex and base against the middle, in mm
    #[arg(long, value_name = "MM")]
    bend: Option<f64>,
    /// Turn of the sections from apex to base, in degrees (shows with --ovality)
    #[arg(long, value_name = "DEGREES")]
    twist: Option<f64>,
    /// Lateral-septal over antero-inferior diameter, minus 1
    #[arg(long, value_name = "FRACTION")]
    ovality: Option<f64>,
    /// Slope of the valve plane, in degrees: positive ends the septal wall nearer the apex
    #[arg(long, value_name = "DEGREES")]
    base_tilt: Option<f64>,
    /// Leave out where the study lies in the patient
    #[arg(long)]
    no_orientation: bool,
}

#[derive(clap::Args)]
struct UptakeArgs {
    /// A perfusion defect: site (apical, anterior, inferior, septal, lateral), share of the wall 0-1, share of uptake lost 0-1; repeatable
    #[arg(long, value_name = "SITE:EXTENT:SEVERITY", value_parser = defect)]
    defect: Vec<Defect>,
    /// How far normal uptake varies over the wall, 0-1
    #[arg(long, value_name = "FRACTION")]
    nonuniformity: Option<f64>,
    /// Activity outside the organs
    #[arg(long, value_name = "FRACTION")]
    background: Option<f64>,
    /// Activity of the blood
    #[arg(long, value_name = "FRACTION")]
    blood: Option<f64>,
    /// Uptake of the right ventricle's wall; 0: none
    #[arg(long, value_name = "FRACTION")]
    right_ventricle: Option<f64>,
    /// A liver at this distance under the inferior wall, in mm, with this uptake
    #[arg(long, value_name = "MM[:UPTAKE]", value_parser = liver, allow_hyphen_values = true)]
    liver: Option<Liver>,
}

#[derive(clap::Args)]
struct ImagingArgs {
    /// Gates of the cycle
    #[arg(long, value_name = "N")]
    gates: Option<usize>,
    /// Mean R-R interval, in ms
    #[arg(long, value_name = "MS")]
    rr: Option<f64>,
    /// Columns, rows and slices [default: 64x64x24]
    #[arg(long, value_name = "XxYxZ", value_parser = list::<usize, 3>)]
    grid: Option<[usize; 3]>,
    /// Spacing of columns, rows and slices, in mm [default: 2.87x2.87x5.74]
    #[arg(long, value_name = "XxYxZ", value_parser = list::<f64, 3>)]
    spacing: Option<[f64; 3]>,
    /// Full width at half maximum of the point-spread function, in mm; 0: no blur
    #[arg(long, value_name = "MM")]
    fwhm: Option<f64>,
    /// A wider Gaussian under the first: its share of the counts and its width in mm
    #[arg(long, value_name = "FRACTION:MM", value_parser = tail)]
    tail: Option<Tail>,
    /// Growth of the width from row to row, in mm per mm
    #[arg(long, value_name = "SLOPE", allow_negative_numbers = true)]
    growth: Option<f64>,
    /// Expected count of the brightest voxel in the wall
    #[arg(long, value_name = "N")]
    counts: Option<f64>,
    /// Seed of the Poisson noise
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Expected counts instead of Poisson noise (DICOM: scaled to a peak of 30000 and rounded)
    #[arg(long, conflicts_with = "seed")]
    noise_free: bool,
    /// Radius of a circular field of view, in mm; zero outside
    #[arg(long, value_name = "MM")]
    field_of_view: Option<f64>,
    /// Counts of the last gate against the others, 0-1
    #[arg(long, value_name = "FRACTION")]
    last_gate: Option<f64>,
    /// Phases of the cycle averaged in each gate: blur of motion
    #[arg(long, value_name = "N")]
    phases: Option<usize>,
    /// Least number of samples along each side of a voxel (1 mm or finer in any case)
    #[arg(long, value_name = "N")]
    supersampling: Option<usize>,
}

/// Runs it.
pub(crate) fn run(Args { options }: Args) -> anyhow::Result<()> {
    let phantom = phantom_of(&options)?;
    let simulation = phantom::simulate(&phantom)?;
    let bytes = match options.format {
        FileFormat::Dicom => phantom::dicom::write(&simulation.study)?,
        FileFormat::Nifti => phantom::nifti::write(&simulation.study),
        FileFormat::NiftiGz => phantom::nifti::write_gzipped(&simulation.study)?,
    };
    std::fs::write(&options.output, bytes).with_context(|| format!("cannot write {}", options.output.display()))?;
    if let Some(path) = &options.truth {
        let json = serde_json::json!({ "phantom": phantom, "truth": simulation.truth });
        std::fs::write(path, format!("{json:#}\n")).with_context(|| format!("cannot write {}", path.display()))?;
    }
    print_summary(&options, &simulation);
    Ok(())
}

fn print_summary(options: &Options, Simulation { study, truth }: &Simulation) {
    if truth.has_ventricle {
        println!("gate  endocardial ml  epicardial ml");
        for (index, gate) in truth.gates.iter().enumerate() {
            println!("{:4}  {:14.2}  {:13.2}", index + 1, gate.endocardial_ml, gate.epicardial_ml);
        }
        println!(
            "EDV {:.2} ml (gate {})   ESV {:.2} ml (gate {})",
            truth.edv_ml, truth.end_diastolic_gate, truth.esv_ml, truth.end_systolic_gate
        );
        println!("SV {:.2} ml   EF {:.1} %   (continuous cycle: {:.1} %)", truth.sv_ml, truth.ef_percent, truth.continuous_ef_percent);
        if !truth.within_grid {
            println!("note: the grid cuts the ventricle; volumes are those of the whole ventricle");
        }
    } else {
        println!("no ventricle in this study");
    }
    let scale = phantom::dicom::scale(study);
    if matches!(options.format, FileFormat::Dicom) && (scale - 1.0).abs() > f64::EPSILON {
        println!("note: counts were multiplied by {scale:.6} to fit 16 bits");
    }
    println!("{}", options.output.display());
    if let Some(path) = &options.truth {
        println!("{}", path.display());
    }
}

fn phantom_of(options: &Options) -> anyhow::Result<Phantom> {
    let mut phantom = match options.preset {
        Preset::Demo => Phantom::demo(),
        Preset::Paper => Phantom::paper(),
        Preset::HeartLike => Phantom::heart_like(),
        Preset::Normal => Phantom::normal(),
        Preset::Dilated => Phantom::dilated(),
        Preset::Small => Phantom::small(),
        Preset::Bent => Phantom::bent(),
        Preset::Twisted => Phantom::twisted(),
        Preset::Empty => Phantom::empty(),
    };
    options.shape.apply(&mut phantom.shape)?;
    phantom.regional.extend(&options.shape.regional);
    options.place.apply(&mut phantom);
    options.uptake.apply(&mut phantom);
    options.imaging.apply(&mut phantom);
    Ok(phantom)
}

/// Overwrites a value that was given.
fn set<T: Copy>(value: &mut T, given: Option<T>) {
    if let Some(given) = given {
        *value = given;
    }
}

impl ShapeArgs {
    fn apply(&self, shape: &mut Shape) -> anyhow::Result<()> {
        let for_ventricles = [self.edv, self.esv, self.ef, self.wall, self.elongation, self.shortening].iter().any(Option::is_some);
        let for_cylinders = self.radii.is_some() || self.heights.is_some();
        match shape {
            Shape::Ventricle(ventricle) if !for_cylinders => self.apply_to_ventricle(ventricle),
            Shape::Cylinder(cylinder) if !for_ventricles => {
                set(&mut cylinder.inner_radius_mm, self.radii.map(|radii| radii[0]));
                set(&mut cylinder.outer_radius_mm, self.radii.map(|radii| radii[1]));
                set(&mut cylinder.inner_height_mm, self.heights.map(|heights| heights[0]));
                set(&mut cylinder.outer_height_mm, self.heights.map(|heights| heights[1]));
            }
            Shape::Decoy(_) | Shape::Empty if !for_cylinders && !for_ventricles => {}
            _ if for_cylinders => anyhow::bail!("--radii and --heights describe the paper's object: use them with --preset paper"),
            _ => anyhow::bail!(
                "--edv, --esv, --ef, --wall, --elongation and --shortening describe a beating ventricle: choose such a --preset"
            ),
        }
        Ok(())
    }

    fn apply_to_ventricle(&self, ventricle: &mut Ventricle) {
        // A new end-diastolic volume alone keeps the preset's ejection fraction.
        let ejected = self.ef.map_or(1.0 - ventricle.esv_ml / ventricle.edv_ml, |percent| percent / 100.0);
        set(&mut ventricle.edv_ml, self.edv);
        ventricle.esv_ml = self.esv.unwrap_or(ventricle.edv_ml * (1.0 - ejected));
        set(&mut ventricle.wall_ml, self.wall);
        set(&mut ventricle.elongation, self.elongation);
        set(&mut ventricle.shortening, self.shortening);
    }
}

impl PlaceArgs {
    fn apply(&self, phantom: &mut Phantom) {
        set(&mut phantom.pose.tilt_degrees, self.tilt);
        set(&mut phantom.pose.offset_mm, self.offset);
        phantom.pose.reversed |= self.reversed;
        set(&mut phantom.deformation.bend_mm, self.bend);
        set(&mut phantom.deformation.twist_degrees, self.twist);
        set(&mut phantom.deformation.ovality, self.ovality);
        set(&mut phantom.deformation.base_tilt_degrees, self.base_tilt);
        phantom.imaging.oriented &= !self.no_orientation;
    }
}

impl UptakeArgs {
    fn apply(&self, phantom: &mut Phantom) {
        let uptake = &mut phantom.uptake;
        uptake.defects.extend(&self.defect);
        set(&mut uptake.nonuniformity, self.nonuniformity);
        set(&mut uptake.background, self.background);
        set(&mut uptake.blood_pool, self.blood);
        set(&mut uptake.right_ventricle, self.right_ventricle);
        uptake.liver = self.liver.or(uptake.liver);
    }
}

impl ImagingArgs {
    fn apply(&self, phantom: &mut Phantom) {
        let imaging = &mut phantom.imaging;
        let Grid { shape: [nz, ny, nx], spacing_mm: [dz, dy, dx] } = imaging.grid;
        let ([nx, ny, nz], [dx, dy, dz]) = (self.grid.unwrap_or([nx, ny, nz]), self.spacing.unwrap_or([dx, dy, dz]));
        imaging.grid = Grid { shape: [nz, ny, nx], spacing_mm: [dz, dy, dx] };
        set(&mut imaging.gates, self.gates);
        set(&mut imaging.rr_interval_ms, self.rr);
        let Psf { fwhm_mm, tail, growth } = &mut imaging.psf;
        set(fwhm_mm, self.fwhm);
        *tail = self.tail.or(*tail);
        set(growth, self.growth);
        set(&mut imaging.counts, self.counts);
        imaging.noise_seed = if self.noise_free { None } else { self.seed.or(imaging.noise_seed) };
        imaging.field_of_view_mm = self.field_of_view.or(imaging.field_of_view_mm);
        set(&mut imaging.last_gate_fraction, self.last_gate);
        set(&mut imaging.motion_samples, self.phases);
        set(&mut imaging.supersampling, self.supersampling);
    }
}

/// Exactly `N` numbers, separated by `,` or `x`.
fn list<T: FromStr, const N: usize>(text: &str) -> Result<[T; N], String> {
    let numbers: Option<Vec<T>> = text.split([',', 'x']).map(|part| part.trim().parse().ok()).collect();
    numbers.and_then(|numbers| numbers.try_into().ok()).ok_or_else(|| format!("expected {N} numbers separated by , or x"))
}

fn defect(text: &str) -> Result<Defect, String> {
    let expected = "expected SITE:EXTENT:SEVERITY, such as inferior:0.32:0.9";
    let [site, extent, severity] = text.split(':').collect::<Vec<_>>().try_into().map_err(|_| expected)?;
    let site = match site {
        "apical" => Site::Apical,
        "anterior" => Site::Anterior,
        "inferior" => Site::Inferior,
        "septal" => Site::Septal,
        "lateral" => Site::Lateral,
        _ => return Err(format!("no such site: {site}; there are apical, anterior, inferior, septal and lateral")),
    };
    let number = |text: &str| text.parse::<f64>().map_err(|_| expected.to_owned());
    Ok(Defect { site, extent: number(extent)?, severity: number(severity)? })
}

fn regional(text: &str) -> Result<Regional, String> {
    let mut parts = text.split(':');
    let middle = parts.next().unwrap_or_default();
    let expected = || format!("{middle} is no middle: it is anterior, septal, inferior, lateral, all, or a number of degrees");
    let mut part = match middle {
        "all" => Regional::sector(0.0, 360.0),
        "anterior" => Regional::sector(0.0, 60.0),
        "septal" => Regional::sector(90.0, 60.0),
        "inferior" => Regional::sector(180.0, 60.0),
        "lateral" => Regional::sector(270.0, 60.0),
        _ => Regional::sector(middle.parse().map_err(|_| expected())?, 60.0),
    };
    for pair in parts {
        let (key, value) = pair.split_once('=').ok_or_else(|| format!("{pair} is not KEY=VALUE, such as delay=90"))?;
        let value: f64 = value.parse().map_err(|_| format!("{value} is not a number"))?;
        match key {
            "width" => part.width_degrees = value,
            "edge" => part.edge_degrees = value,
            "from" => part.heights[0] = value,
            "to" => part.heights[1] = value,
            "delay" => part.delay = value / 360.0,
            "amplitude" => part.amplitude = value,
            "thickness" => part.thickness = value,
            _ => return Err(format!("no such key: {key}; there are width, edge, from, to, delay, amplitude and thickness")),
        }
    }
    Ok(part)
}

/// A hot liver takes up as much as the wall, unless it is said.
fn liver(text: &str) -> Result<Liver, String> {
    let (gap, uptake) = text.split_once(':').unwrap_or((text, "1"));
    let number = |text: &str| text.parse::<f64>().map_err(|_| "expected MM or MM:UPTAKE, such as 5:1.5".to_owned());
    Ok(Liver { gap_mm: number(gap)?, uptake: number(uptake)? })
}

fn tail(text: &str) -> Result<Tail, String> {
    let expected = "expected FRACTION:MM, such as 0.2:25";
    let (fraction, fwhm) = text.split_once(':').ok_or(expected)?;
    let number = |text: &str| text.parse::<f64>().map_err(|_| expected.to_owned());
    Ok(Tail { fraction: number(fraction)?, fwhm_mm: number(fwhm)? })
}
