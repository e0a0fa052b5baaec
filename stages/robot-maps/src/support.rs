//! Valid robot support.

use rogs_schemas::records::robot::NO_LINK;

use crate::params::SupportRule;

/// 1 where a pixel is valid support: covered with a depth in range, all of its 3x3 neighbourhood covered so too, and no
/// two links of that neighbourhood far apart in depth. `[H, W]`
#[must_use]
pub fn valid_support(depth_m: &[f32], link: &[u8], width: u32, height: u32, rule: &SupportRule) -> Vec<u8> {
    let (w, h) = (width as usize, height as usize);
    let in_range = |pixel: usize| (rule.min_depth_m..=rule.max_depth_m).contains(&depth_m[pixel]);
    let raw: Vec<bool> = (0..w * h)
        .map(|pixel| link[pixel] != NO_LINK && in_range(pixel))
        .collect();
    let mut support = vec![0u8; w * h];
    let mut window = Vec::with_capacity(9);
    for row in 0..h {
        for column in 0..w {
            let pixel = row * w + column;
            if !raw[pixel] {
                continue;
            }
            window.clear();
            for y in row.saturating_sub(1)..(row + 2).min(h) {
                let columns = column.saturating_sub(1)..(column + 2).min(w);
                window.extend(columns.map(|x| y * w + x).filter(|&neighbour| raw[neighbour]));
            }
            let eroded = rule.erode && window.len() < 9;
            support[pixel] = u8::from(!eroded && !spans_links(&window, depth_m, link, rule.link_boundary_m));
        }
    }
    support
}

/// True when two pixels of the window show different links at depths that differ by more than `limit`.
fn spans_links(window: &[usize], depth_m: &[f32], link: &[u8], limit: f32) -> bool {
    let same = window.iter().all(|&pixel| link[pixel] == link[window[0]]);
    let apart = |a: usize, b: usize| link[a] != link[b] && (depth_m[a] - depth_m[b]).abs() > limit;
    !same && window.iter().any(|&a| window.iter().any(|&b| apart(a, b)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const W: u32 = 7;
    const H: u32 = 6;

    /// A 5x4 block of link 2 from column 1, row 1, at 1 m.
    fn block() -> (Vec<f32>, Vec<u8>) {
        let inside = |pixel: u32| (1..6).contains(&(pixel % W)) && (1..5).contains(&(pixel / W));
        let depth = (0..W * H).map(|pixel| if inside(pixel) { 1.0 } else { 0.0 }).collect();
        (
            depth,
            (0..W * H)
                .map(|pixel| if inside(pixel) { 2 } else { NO_LINK })
                .collect(),
        )
    }

    fn count(support: &[u8]) -> u32 {
        support.iter().map(|&value| u32::from(value)).sum()
    }

    #[test]
    fn erosion_takes_the_rim() {
        let (depth, link) = block();
        let support = valid_support(&depth, &link, W, H, &SupportRule::default());
        assert_eq!(count(&support), 3 * 2);
        assert_eq!(support[(2 * W + 2) as usize], 1);
        let whole = valid_support(
            &depth,
            &link,
            W,
            H,
            &SupportRule {
                erode: false,
                ..SupportRule::default()
            },
        );
        assert_eq!(count(&whole), 5 * 4);
        let full = valid_support(&[1.0; 42], &[0; 42], W, H, &SupportRule::default());
        assert_eq!(count(&full), (W - 2) * (H - 2), "image borders count as uncovered");
    }

    #[test]
    fn a_depth_step_between_links_is_dropped_but_not_within_a_link() {
        let (mut depth, mut link) = block();
        let far = (3 * W + 3) as usize;
        depth[far] = 1.2;
        assert_eq!(count(&valid_support(&depth, &link, W, H, &SupportRule::default())), 6);
        link[far] = 3;
        assert_eq!(count(&valid_support(&depth, &link, W, H, &SupportRule::default())), 0);
        depth[far] = 1.02;
        assert_eq!(count(&valid_support(&depth, &link, W, H, &SupportRule::default())), 6);
    }

    #[test]
    fn depths_out_of_range_are_no_support() {
        let (mut depth, link) = block();
        depth[(2 * W + 2) as usize] = 0.04;
        assert_eq!(count(&valid_support(&depth, &link, W, H, &SupportRule::default())), 2);
        let near = SupportRule {
            max_depth_m: 0.9,
            ..SupportRule::default()
        };
        assert_eq!(count(&valid_support(&depth, &link, W, H, &near)), 0);
    }
}
