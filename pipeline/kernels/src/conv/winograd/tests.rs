//! Against direct sums.

use super::*;
use crate::noise::noise;
use crate::{Conv3x3, Precision};

#[test]
fn equals_the_direct_convolution() {
    for (height, width, inputs, outputs) in [(4, 4, 1, 1), (8, 12, 3, 5), (2, 6, 16, 33), (22, 40, 48, 48)] {
        let (weight, bias) = (noise(outputs * inputs * 9, 2), noise(outputs, 3));
        let direct = Conv3x3::new(&weight, &bias, outputs, inputs, Precision::F32);
        let input = noise(2 * inputs * height * width, 1);
        let residual = noise(2 * outputs * height * width, 4);
        for (tiles, error) in [(TileSize::Two, 1e-6), (TileSize::Four, 4e-6)] {
            let tiled = Winograd::new(&weight, &bias, inputs, outputs, tiles);
            let bound = error * (9.0 * inputs as f32 + 1.0);
            for (rectify, residual) in [(false, None), (true, None), (false, Some(residual.as_slice()))] {
                let found = tiled.run(&input, [height, width], rectify, residual);
                let expected = direct.run(&input, [height, width], rectify, residual);
                assert_eq!(found.len(), expected.len());
                for (found, expected) in found.iter().zip(&expected) {
                    assert!(
                        (found - expected).abs() < bound,
                        "{tiles:?} {height}x{width} {inputs} -> {outputs}: {found} {expected}"
                    );
                }
            }
        }
    }
}

/// Images in pieces, several panels, sides that cut tiles.
#[test]
fn odd_sizes_and_any_number_of_threads() {
    for (height, width, inputs, outputs) in [
        (17, 33, 3, 5),
        (19, 35, 40, 33),
        (3, 150, 2, 70),
        (1, 2, 70, 40),
        (3, 4, 600, 450),
    ] {
        let (weight, bias) = (noise(outputs * inputs * 9, 2), noise(outputs, 3));
        let (map, area) = (noise(inputs * height * width, 1), height * width);
        let planar = transposed(&map, area, |value| value);
        let direct = Conv3x3::new(&weight, &bias, outputs, inputs, Precision::F32);
        let expected = direct.run(&planar, [height, width], false, None);
        let expected = transposed(&expected, outputs, |value| value.max(0.0));
        for (tiles, error) in [(TileSize::Two, 1e-6), (TileSize::Four, 4e-6)] {
            let tiled = Winograd::new(&weight, &bias, inputs, outputs, tiles);
            let run = |threads: usize| {
                let mut out = vec![f32::NAN; area * outputs];
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| tiled.rectified(&map, [height, width], &mut out));
                out
            };
            let found = run(1);
            assert_eq!(found, run(3));
            for (found, expected) in found.iter().zip(&expected) {
                assert!(
                    (found - expected).abs() < error * (9 * inputs + 1) as f32,
                    "{found} {expected}"
                );
            }
        }
    }
}
