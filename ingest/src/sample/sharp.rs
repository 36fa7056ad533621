//! The sharp kernel: for heights whose spacing hardly changes.
//!
//! A Lanczos kernel of three lobes, corrected so that planes stay planes, and bounded by the four
//! samples around: no ringing at steps. A summit or a pit, a sample that is higher or lower than
//! its eight neighbours, is assigned to the nearest post, because between samples every kernel
//! would cut it off. Compared with other kernels in docs/ingest.md.

use crate::source::window::Window;
use std::ops::RangeInclusive;

/// Range of source pixels per post in which spacing hardly changes. With more, the kernel has to
/// average.
pub(super) const SPACINGS: RangeInclusive<f64> = 0.5..=1.5;
/// Lobes of the kernel, and so how far it reaches.
pub(super) const SUPPORT: f64 = 3.0;
/// Half the distance of posts plus a tenth of that, because posts may be slightly rotated against
/// the source's rows.
const NEAR: f64 = 0.55;

/// Weights of the six samples around a position that is `t` (0 to 1) beyond the third of them:
/// `sinc(x)·sinc(x/3)` (Duchon, Lanczos filtering in one and two dimensions, 1979), with a sum of 1
/// and, by shifting weight between the two in the middle, with the position as the mean of their
/// positions: so planes stay planes.
pub(super) fn weights(t: f64) -> [f64; 6] {
    use std::f64::consts::PI;
    // sin(πx) at whole distances differs in its sign alone; sin(πx/3) turns by 60°.
    let wide = (PI * t / 3.0).sin_cos();
    let sine = (PI * t).sin();
    let mut weights = [0.0; 6];
    for (k, weight) in weights.iter_mut().enumerate() {
        let i = k as f64 - 2.0;
        let x = t - i;
        if x.abs() < 1e-9 {
            *weight = 1.0;
            continue;
        }
        let turn = (PI * i / 3.0).sin_cos();
        let alternating = if k % 2 == 0 { sine } else { -sine };
        *weight = 3.0 * alternating * (wide.0 * turn.1 - wide.1 * turn.0) / (PI * PI * x * x);
    }
    let sum: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|w| *w /= sum);
    let moment: f64 = weights.iter().enumerate().map(|(k, w)| w * (k as f64 - 2.0 - t)).sum();
    weights[2] += moment;
    weights[3] -= moment;
    weights
}

/// A value clamped to the range of the samples around its position, or the summit or pit that is
/// assigned to its post.
pub(super) fn bounded<const C: usize>(
    window: &Window<C>,
    position: [f64; 2],
    spacing: [f64; 2],
    mut value: [f32; C],
) -> [f32; C] {
    let first = position.map(|v| v.floor() as i64);
    let around = [[0, 0], [1, 0], [0, 1], [1, 1]].map(|[x, y]| [first[0] + x, first[1] + y]);
    for channel in 0..C {
        let (mut low, mut high) = (f32::MAX, f32::MIN);
        let (mut pit, mut summit) = (f32::MAX, f32::MIN);
        for place in around {
            let Some(sample) = window.known_near(place).map(|pixel| pixel[channel]) else { continue };
            (low, high) = (low.min(sample), high.max(sample));
            let is_near = |k: usize| (place[k] as f64 - position[k]).abs() <= NEAR * spacing[k].max(1.0);
            if is_near(0) && is_near(1) {
                match extreme(window, place, channel, sample) {
                    Some(Extreme::Summit) => summit = summit.max(sample),
                    Some(Extreme::Pit) => pit = pit.min(sample),
                    None => {}
                }
            }
        }
        if low <= high {
            value[channel] = value[channel].clamp(low, high);
        }
        if summit > f32::MIN {
            value[channel] = summit;
        } else if pit < f32::MAX {
            value[channel] = pit;
        }
    }
    value
}

enum Extreme {
    Summit,
    Pit,
}

/// Whether a sample is higher or lower than all of its eight neighbours, of which at least three
/// must be known. (Radar leaves voids beside the steepest summits.)
fn extreme<const C: usize>(window: &Window<C>, [x, y]: [i64; 2], channel: usize, sample: f32) -> Option<Extreme> {
    let (mut is_summit, mut is_pit, mut known) = (true, true, 0);
    for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1)] {
        let Some(beside) = window.known_near([x + dx, y + dy]).map(|pixel| pixel[channel]) else { continue };
        known += 1;
        is_summit &= sample > beside;
        is_pit &= sample < beside;
        if !is_summit && !is_pit {
            return None;
        }
    }
    (known >= 3).then_some(if is_summit { Extreme::Summit } else { Extreme::Pit })
}

#[cfg(test)]
mod tests {
    use super::super::kernel::Kernel;
    use crate::source::window::Window;

    fn window(f: impl Fn(i64, i64) -> f32) -> Window<1> {
        let mut window = Window::new([0, 0], [32, 32]);
        window.pixels.iter_mut().enumerate().for_each(|(at, p)| *p = [f(at as i64 % 32, at as i64 / 32)]);
        window
    }

    fn value(window: &Window<1>, spacing: f64, position: [f64; 2]) -> f32 {
        Kernel::of_heights([spacing; 2]).sample(window, position).unwrap()[0]
    }

    #[test]
    fn planes_stay_planes_and_samples_stay_samples() {
        let plane = window(|i, j| 20.0 * i as f32 - 7.0 * j as f32);
        for k in 0..50 {
            let at = [10.0 + 0.037 * f64::from(k), 12.0 + 0.061 * f64::from(k)];
            let expected = 20.0 * at[0] - 7.0 * at[1];
            assert!((f64::from(value(&plane, 1.1, at)) - expected).abs() < 1e-4, "{at:?}");
        }
        assert_eq!(value(&plane, 1.0, [14.0, 9.0]), 217.0);
        assert_eq!(value(&plane, 1.2, [14.0, 9.5]), 213.5);
    }

    #[test]
    fn the_weights_are_those_of_lanczos() {
        let sinc = |x: f64| if x == 0.0 { 1.0 } else { (std::f64::consts::PI * x).sin() / (std::f64::consts::PI * x) };
        for t in [0.01, 0.3, 0.5, 0.99] {
            let weights = super::weights(t);
            let plain =
                [0, 1, 2, 3, 4, 5].map(|k| sinc(t - (f64::from(k) - 2.0)) * sinc((t - (f64::from(k) - 2.0)) / 3.0));
            assert!(weights.iter().zip(plain).all(|(a, b)| (a - b).abs() < 0.02), "{weights:?} {plain:?}");
            assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_step_does_not_ring() {
        let step = window(|i, _| if i < 16 { 100.0 } else { 200.0 });
        for k in 0..200 {
            let height = value(&step, 1.05, [10.0 + 0.06 * f64::from(k), 15.3]);
            assert!((100.0..=200.0).contains(&height), "{height} at {k}");
        }
    }

    #[test]
    fn summits_and_pits_go_to_the_nearest_post() {
        let peak = window(|i, j| 500.0 - 40.0 * (i as f32 - 16.0).abs() - 30.0 * (j as f32 - 15.0).abs());
        let pit = window(|i, j| 40.0 * (i as f32 - 16.0).abs() + 30.0 * (j as f32 - 15.0).abs());
        for phase in [0.0, 0.13, 0.5, 0.77] {
            let posts = (0..16)
                .flat_map(|n| (0..16).map(move |m| [5.0 + phase + 1.1 * f64::from(m), 6.2 + 1.1 * f64::from(n)]));
            let heights: Vec<[f32; 2]> = posts.map(|at| [value(&peak, 1.1, at), value(&pit, 1.1, at)]).collect();
            assert_eq!(heights.iter().map(|h| h[0]).fold(f32::MIN, f32::max), 500.0, "{phase}");
            assert_eq!(heights.iter().map(|h| h[1]).fold(f32::MAX, f32::min), 0.0, "{phase}");
        }
    }
}
