use super::*;
use crate::pipeline::{
    borders::BorderPoint,
    monitor::Silent,
    parameters::Parameters,
    simd::{Level, use_at_most},
};

/// The border of a ball, two voxels thick at most.
pub(in crate::pipeline) fn sphere(grid: Grid, centre: DVec3, radius: f64) -> Border {
    let thickness = grid.spacing_mm.iter().fold(0.0, |a: f64, &b| a.max(b)) / 2.0;
    let all = Array3::from_elem(grid.shape, ());
    let points = all
        .indexed_iter()
        .map(|((z, y, x), ())| [z, y, x])
        .filter(|&voxel| (grid.position_mm(voxel).distance(centre) - radius).abs() <= thickness)
        .map(|voxel| {
            let out = (grid.position_mm(voxel) - centre).normalize();
            BorderPoint { voxel, position_mm: centre + out * radius, normal: out }
        })
        .collect();
    Border { points }
}

#[test]
fn the_flow_points_at_the_border_from_both_sides_everywhere() {
    let grid = Grid { shape: [20, 36, 36], spacing_mm: [5.0, 2.8, 2.8] };
    let centre = grid.position_mm([10, 18, 18]);
    let border = sphere(grid, centre, 25.0);
    let flow = flow(&grid, &border, &Parameters::paper().gvf, &Silent).unwrap();
    assert!(flow.residual.iter().all(|&residual| residual <= 1e-4), "{:?}", flow.residual);
    for radius in [8.0, 14.0, 31.0, 35.0] {
        for k in 0..24 {
            let (polar, turn) = (f64::from(k) / 24.0 * 2.0 + 0.5, f64::from(k) * 0.7);
            let out = DVec3::new(polar.sin() * turn.cos(), polar.sin() * turn.sin(), polar.cos());
            let field = flow.direction(centre + out * radius);
            let towards = if radius < 25.0 { out } else { -out };
            assert!(field.dot(towards) > 0.75, "r {radius}, {out}: {field}");
        }
    }
}

#[test]
fn the_solution_is_that_of_the_dense_system() {
    // A grid small enough to write the matrix out and eliminate, with b that no edge map has.
    let (shape, spacing_mm, mu) = ([3_usize, 4, 5], [2.0_f64, 1.0, 1.5], 0.3);
    let voxels: Vec<[usize; 3]> = Array3::from_elem(shape, ()).indexed_iter().map(|((z, y, x), ())| [z, y, x]).collect();
    let b: Vec<f32> = voxels.iter().map(|[z, y, x]| ((z * 7 + y * 3 + x) % 5) as f32 * 0.1).collect();
    let right: Vec<f32> = voxels.iter().map(|[z, y, x]| ((z + 2 * y + 3 * x) % 4) as f32 - 1.5).collect();
    let mut rows: Vec<Vec<f64>> = voxels
        .iter()
        .enumerate()
        .map(|(i, _)| {
            let mut row = vec![0.0; voxels.len() + 1];
            (row[i], row[voxels.len()]) = (f64::from(b[i]), f64::from(right[i]));
            row
        })
        .collect();
    for (i, a) in voxels.iter().enumerate() {
        for (j, b) in voxels.iter().enumerate() {
            let apart: Vec<usize> = (0..3).filter(|&axis| a[axis] != b[axis]).collect();
            if let [axis] = apart[..]
                && a[axis].abs_diff(b[axis]) == 1
            {
                let weight = mu / (spacing_mm[axis] * spacing_mm[axis]);
                rows[i][i] += weight;
                rows[i][j] -= weight;
            }
        }
    }
    for pivot in 0..voxels.len() {
        let scaled: Vec<f64> = rows[pivot].iter().map(|value| value / rows[pivot][pivot]).collect();
        for (number, row) in rows.iter_mut().enumerate() {
            let part = row[pivot];
            for (value, scaled) in row.iter_mut().zip(&scaled) {
                *value = if number == pivot { *scaled } else { *value - part * scaled };
            }
        }
    }
    let mut system = System::default();
    system.set_up(shape, spacing_mm.map(|h| (mu / (h * h)) as f32), &b);
    let mut found = vec![0.0; voxels.len()];
    let reached = system.solve::<()>(&right, 1e-7, &mut found, || Ok(())).unwrap();
    assert!(reached.residual <= 1e-6, "{reached:?}");
    for (found, row) in found.iter().zip(&rows) {
        assert!((f64::from(*found) - row[voxels.len()]).abs() < 1e-4, "{found} {}", row[voxels.len()]);
    }
}

/// f on a grid: 1 on an ellipsoid's shell about its middle.
fn shell(grid: &Grid) -> Array3<f32> {
    let middle = grid.position_mm(grid.shape.map(|length| length / 2));
    let extent = grid.position_mm(grid.shape.map(|length| length - 1)).max(DVec3::splat(1.0));
    let radius = |voxel: [usize; 3]| ((grid.position_mm(voxel) - middle) / (0.3 * extent)).length();
    let thick = (grid.step_mm() / (0.3 * extent)).max_element() / 2.0;
    Array3::from_shape_fn(grid.shape, |(z, y, x)| if (radius([z, y, x]) - 1.0).abs() <= thick { 1.0 } else { 0.0 })
}

fn solved(grid: &Grid, map: &Array3<f32>, tolerance: f64) -> Solution {
    solve(grid, map, unit_mu(10.0), tolerance, &mut Workspace::default(), &Silent).unwrap()
}

/// The residual of a field, from the equation itself in f64.
fn residual_of(grid: &Grid, map: &Array3<f32>, field: &VectorField, mu: f64) -> [f64; 3] {
    let slope = gradient(grid, map);
    let mut b = Vec::new();
    squared_length(&slope, &mut b);
    let b = Array3::from_shape_vec(grid.shape, b).unwrap();
    std::array::from_fn(|component| {
        let (slope, v) = (&slope.components[component], &field.components[component]);
        let (mut left, mut whole) = (0.0, 0.0);
        for ((z, y, x), &b) in b.indexed_iter() {
            let here = [z, y, x];
            let right = f64::from(b) * f64::from(slope[here]);
            let (mut product, mut diagonal) = (f64::from(b) * f64::from(v[here]), f64::from(b));
            for (axis, h) in grid.spacing_mm.into_iter().enumerate() {
                for step in [-1_isize, 1] {
                    let mut other = here;
                    let Some(moved) = other[axis].checked_add_signed(step).filter(|&i| i < grid.shape[axis]) else { continue };
                    other[axis] = moved;
                    product += mu / (h * h) * (f64::from(v[here]) - f64::from(v[other]));
                    diagonal += mu / (h * h);
                }
            }
            left += (right - product).powi(2) / diagonal;
            whole += right * right / diagonal;
        }
        if whole > 0.0 { (left / whole).sqrt() } else { 0.0 }
    })
}

#[test]
fn the_residual_is_that_of_the_field_on_grids_of_any_shape_and_spacing() {
    let spacings = [[5.74, 2.87, 2.87], [3.0; 3], [8.0, 1.0, 2.0], [1.0, 2.0, 8.0], [2.0, 8.0, 1.0]];
    let shapes = [[24, 64, 64], [7, 31, 17], [1, 20, 23], [2, 13, 40], [12, 1, 33], [23, 29, 1], [1, 1, 9], [1, 1, 1], [5, 97, 3]];
    for shape in shapes {
        for spacing_mm in spacings {
            let grid = Grid { shape, spacing_mm };
            let map = shell(&grid);
            let found = solved(&grid, &map, 1e-5);
            let told = residual_of(&grid, &map, &found.field, unit_mu(10.0));
            for component in 0..3 {
                assert!(found.residual[component] <= 1e-5, "{grid:?}: {:?} in {:?}", found.residual, found.iterations);
                // What rounding to f32 adds to either is 10⁻⁷.
                assert!((found.residual[component] - told[component]).abs() < 3e-7, "{grid:?}: {:?}, {told:?}", found.residual);
                assert!(found.field.components[component].iter().all(|value| value.is_finite()));
            }
        }
    }
}

#[test]
fn as_many_iterations_on_a_fine_grid_as_on_a_coarse_one() {
    for (shape, h) in [([6, 16, 16], 4.0), ([12, 32, 32], 2.0), ([24, 64, 64], 1.0), ([48, 128, 128], 0.5)] {
        let grid = Grid { shape, spacing_mm: [5.74 * h, 2.87 * h, 2.87 * h] };
        let found = solved(&grid, &shell(&grid), 1e-4);
        assert!(found.iterations.iter().all(|&iterations| (1..=6).contains(&iterations)), "{shape:?}: {:?}", found.iterations);
    }
}

#[test]
fn strong_and_weak_edges_and_rough_maps_are_solved() {
    let grid = Grid { shape: [11, 26, 31], spacing_mm: [5.0, 3.0, 2.0] };
    // Neither a shell nor smooth: every third voxel, at heights without order.
    let rough =
        Array3::from_shape_fn(grid.shape, |(z, y, x)| if (z * 7 + y * 5 + x * 3) % 3 == 0 { ((z * y + x) % 11) as f32 } else { 0.0 });
    for mu in [1e-9, 1e-6, 1e-3, 1.0, 1e3] {
        let found = solve(&grid, &rough, mu, 1e-5, &mut Workspace::default(), &Silent).unwrap();
        assert!(found.residual.iter().all(|&residual| residual <= 1e-5), "μ {mu}: {:?} in {:?}", found.residual, found.iterations);
        assert!(found.iterations.iter().all(|&iterations| iterations <= 25), "μ {mu}: {:?}", found.iterations);
    }
}

#[test]
fn a_map_without_an_edge_has_no_field() {
    let grid = Grid { shape: [5, 8, 9], spacing_mm: [4.0, 2.0, 2.0] };
    for height in [0.0, 1.0] {
        let map = Array3::from_elem(grid.shape, height);
        let found = solved(&grid, &map, 1e-4);
        assert_eq!((found.residual, found.iterations), ([0.0; 3], [0; 3]));
        assert!(found.field.components.iter().flatten().all(|&value| value == 0.0));
        assert_eq!(explicit::run(&grid, &map, unit_mu(10.0), 1e-4, 100, &Silent).unwrap().iterations, [0; 3]);
    }
}

#[test]
fn explicit_steps_tend_to_the_solved_field() {
    let grid = Grid { shape: [8, 15, 14], spacing_mm: [5.74, 2.87, 2.87] };
    let map = shell(&grid);
    // Steps are many hundred times fewer where diffusion is as strong as the edges are.
    let mu = unit_mu(10_000.0);
    let found = solve(&grid, &map, mu, 1e-6, &mut Workspace::default(), &Silent).unwrap();
    let away = |steps: usize| {
        let stepped = explicit::run(&grid, &map, mu, 0.0, steps, &Silent).unwrap();
        assert_eq!(stepped.iterations, [steps; 3]);
        let told = residual_of(&grid, &map, &stepped.field, mu);
        for (component, told) in told.into_iter().enumerate() {
            assert!((stepped.residual[component] - told).abs() < 1e-6 + 1e-2 * told, "{:?}, {told}", stepped.residual);
        }
        let squares = |a: &Array3<f32>, b: &Array3<f32>| (a - b).iter().map(|&d| f64::from(d).powi(2)).sum::<f64>();
        let pairs = || stepped.field.components.iter().zip(&found.field.components);
        let whole: f64 = found.field.components.iter().map(|v| squares(v, &Array3::zeros(grid.shape))).sum();
        (pairs().map(|(a, b)| squares(a, b)).sum::<f64>() / whole).sqrt()
    };
    let distances = [20, 100, 500, 3000].map(away);
    assert!(distances.is_sorted_by(|a, b| a > b) && distances[3] < 1e-3, "{distances:?}");
}

#[test]
fn the_same_bits_at_every_level_of_instructions_and_after_any_other_problem() {
    let grid = Grid { shape: [13, 37, 34], spacing_mm: [5.74, 2.87, 2.87] };
    let map = shell(&grid);
    let bits = |solution: &Solution| -> Vec<u32> { solution.field.components.iter().flatten().map(|value| value.to_bits()).collect() };
    let mut workspace = Workspace::default();
    let first = solved(&grid, &map, 1e-5);
    for level in Level::ALL {
        use_at_most(level);
        // A larger and a smaller problem before it leave their numbers behind.
        for shape in [[20, 40, 50], [3, 5, 4]] {
            let other = Grid { shape, ..grid };
            solve(&other, &shell(&other), 1e-4, 1e-4, &mut workspace, &Silent).unwrap();
        }
        let again = solve(&grid, &map, unit_mu(10.0), 1e-5, &mut workspace, &Silent).unwrap();
        assert_eq!((bits(&again), again.residual, again.iterations), (bits(&first), first.residual, first.iterations), "{level:?}");
        let stepped = |level| {
            use_at_most(level);
            bits(&explicit::run(&grid, &map, unit_mu(10.0), 0.0, 7, &Silent).unwrap())
        };
        assert_eq!(stepped(level), stepped(Level::Avx512));
    }
    use_at_most(Level::Avx512);
    assert!(workspace.bytes() < 80 * 20 * 40 * 50, "{}", workspace.bytes());
}

#[test]
fn a_solve_is_cancelled_between_iterations() {
    struct Stop;
    impl Monitor for Stop {
        fn is_cancelled(&self) -> bool {
            true
        }
    }
    let grid = Grid { shape: [8, 15, 14], spacing_mm: [5.74, 2.87, 2.87] };
    let map = shell(&grid);
    assert_eq!(solve(&grid, &map, unit_mu(10.0), 1e-4, &mut Workspace::default(), &Stop).err(), Some(PipelineError::Cancelled));
    assert_eq!(explicit::run(&grid, &map, unit_mu(10.0), 1e-4, 100, &Stop).err(), Some(PipelineError::Cancelled));
}
