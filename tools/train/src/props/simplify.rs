//! Meshes of others with fewer triangles: vertices of a grid's cell become their mean (Rossignac and Borrel 1993).

use std::collections::BTreeMap;

use rogs_robot::Mesh;

/// The mesh, or one of at most `most` triangles: cells grow until few enough triangles are left.
pub(super) fn simplified(mesh: Mesh, most: usize) -> Mesh {
    if mesh.triangles.len() <= most {
        return mesh;
    }
    let fold = |start: f32, f: fn(f32, f32) -> f32| -> [f32; 3] {
        std::array::from_fn(|axis| mesh.positions.iter().map(|p| p[axis]).fold(start, f))
    };
    let (low, high) = (fold(f32::INFINITY, f32::min), fold(f32::NEG_INFINITY, f32::max));
    let side = (0..3).map(|axis| high[axis] - low[axis]).fold(0.0, f32::max);
    // From a 400th of the longest side on, half as large again each time.
    let mut cell = side / 400.0;
    loop {
        let clustered = clustered(&mesh, low, cell);
        if clustered.triangles.len() <= most || cell > side {
            return clustered;
        }
        cell *= 1.4;
    }
}

fn clustered(mesh: &Mesh, low: [f32; 3], cell: f32) -> Mesh {
    let place = |p: &[f32; 3]| -> [u32; 3] { std::array::from_fn(|axis| ((p[axis] - low[axis]) / cell) as u32) };
    let mut index_of: BTreeMap<[u32; 3], u32> = BTreeMap::new();
    let mut sums: Vec<([f64; 3], f64)> = Vec::new();
    let cells: Vec<u32> = mesh
        .positions
        .iter()
        .map(|p| {
            let index = *index_of.entry(place(p)).or_insert_with(|| {
                sums.push(([0.0; 3], 0.0));
                sums.len() as u32 - 1
            });
            let (sum, count) = &mut sums[index as usize];
            (0..3).for_each(|axis| sum[axis] += f64::from(p[axis]));
            *count += 1.0;
            index
        })
        .collect();
    let mut seen = std::collections::BTreeSet::new();
    let triangles = mesh
        .triangles
        .iter()
        .map(|triangle| triangle.map(|v| cells[v as usize]));
    let triangles = triangles.filter(|&[a, b, c]| {
        let mut corners = [a, b, c];
        corners.sort_unstable();
        a != b && b != c && c != a && seen.insert(corners)
    });
    let triangles = triangles.collect();
    Mesh {
        positions: sums
            .iter()
            .map(|(sum, count)| sum.map(|value| (value / count) as f32))
            .collect(),
        triangles,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball of rings.
    fn ball(rings: u32) -> Mesh {
        let mut mesh = Mesh::default();
        let (rings_f, around) = (f64::from(rings), 2 * rings);
        for ring in 0..=rings {
            for k in 0..around {
                let (polar, turn) = (
                    std::f64::consts::PI * f64::from(ring) / rings_f,
                    std::f64::consts::PI * f64::from(k) / rings_f,
                );
                let (s, c) = polar.sin_cos();
                mesh.positions
                    .push([(s * turn.cos()) as f32, (s * turn.sin()) as f32, c as f32]);
                let (next, below) = ((k + 1) % around, (ring + 1) * around);
                if ring < rings {
                    mesh.triangles.push([ring * around + k, below + k, below + next]);
                    mesh.triangles
                        .push([ring * around + k, below + next, ring * around + next]);
                }
            }
        }
        mesh
    }

    #[test]
    fn fewer_triangles_lie_near_the_same_surface() {
        let small = simplified(ball(60), 1000);
        assert!(
            (200..=1000).contains(&small.triangles.len()),
            "{}",
            small.triangles.len()
        );
        for p in &small.positions {
            let radius = p.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
            assert!((0.93..1.001).contains(&radius), "{radius}");
        }
        let before = ball(4);
        assert_eq!(simplified(before.clone(), 1000), before);
    }
}
