//! Turns the direction and field of view of a virtual camera into the ray of each of its pixels.

use serde::{Deserialize, Serialize};

use crate::core::error::{Error, Result};

/// A direction in space, not normalised: x right, y up, z ahead, seen from yaw 0 and pitch 0.
pub(super) type Direction = [f64; 3];

/// Pitches that the views of [`spread_views`] take in turn: level, up, down.
const PITCHES_DEG: [f64; 3] = [0.0, 30.0, -30.0];

/// A square perspective view out of a panorama.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Where the camera looks along the horizon: 0 is the panorama's centre, positive is to the right.
    pub yaw_deg: f64,
    /// How far the camera looks up; negative is down.
    pub pitch_deg: f64,
    /// The angle between the centres of the outermost pixels of the middle row, and of the middle column, without any
    /// margin.
    pub fov_deg: f64,
    /// Pixels of a side, without any margin.
    pub size: usize,
}

impl View {
    /// Checks that the view can be rendered.
    ///
    /// # Errors
    /// [`Error::Config`] naming the flag that is out of range.
    pub fn check(&self) -> Result<()> {
        let refuse = |key, range: &str, value: f64| {
            Err(Error::config(key, format!("{value} is out of range; give {range}")))
        };
        if !self.yaw_deg.is_finite() {
            return refuse("yaw", "a number of degrees", self.yaw_deg);
        }
        if !(-90.0..=90.0).contains(&self.pitch_deg) {
            return refuse("pitch", "-90 to 90 degrees", self.pitch_deg);
        }
        if !(1e-3..=MOST_FOV_DEG).contains(&self.fov_deg) {
            return refuse("fov", "0.001 to 170 degrees", self.fov_deg);
        }
        if !(2..=MOST_PIXELS).contains(&self.size) {
            return refuse("size", "2 to 16384 pixels", self.size as f64);
        }
        Ok(())
    }
}

/// The largest field of view of a plane image: beyond it, pixels at the border see next to nothing.
const MOST_FOV_DEG: f64 = 170.0;

/// The largest side of an image.
const MOST_PIXELS: usize = 16384;

impl View {
    /// The angle between the centres of the outermost pixels with `margin` pixels more on each side.
    pub fn fov_with_margin_deg(&self, margin: usize) -> f64 {
        let growth = (self.size - 1 + 2 * margin) as f64 / (self.size - 1) as f64;
        2.0 * ((self.fov_deg.to_radians() / 2.0).tan() * growth).atan().to_degrees()
    }

    /// Checks that the view can be rendered with `margin` pixels more on each side.
    ///
    /// # Errors
    /// As [`check`](Self::check); [`Error::Config`] when the margin makes the image too large or too wide an angle.
    pub fn check_margin(&self, margin: usize) -> Result<()> {
        self.check()?;
        let refuse = |reason| Err(Error::config("margin", reason));
        if margin > MOST_PIXELS || self.size + 2 * margin > MOST_PIXELS {
            let size = self.size;
            return refuse(format!(
                "{margin} on each side of {size} pixels makes more than {MOST_PIXELS}; give less"
            ));
        }
        let fov = self.fov_with_margin_deg(margin);
        // Without a margin the angle returns but for its rounding.
        if margin > 0 && fov > MOST_FOV_DEG {
            return refuse(format!(
                "{margin} pixels on each side make a field of view of {fov:.1} degrees, and {MOST_FOV_DEG} is the most; \
                 give less, or a smaller --fov"
            ));
        }
        Ok(())
    }
}

/// Spreads `count` views over a panorama: equal steps of yaw from its centre to the right, and pitches of
/// 0, 30 and −30 degrees in turn.
///
/// 18 views are six directions, 60° apart, for each of the three pitches.
pub fn spread_views(count: usize, fov_deg: f64, size: usize) -> Vec<View> {
    let view = |i: usize| {
        let turn = 360.0 * i as f64 / count as f64;
        let yaw_deg = if turn > 180.0 { turn - 360.0 } else { turn };
        View { yaw_deg, pitch_deg: PITCHES_DEG[i % PITCHES_DEG.len()], fov_deg, size }
    };
    (0..count).map(view).collect()
}

/// Views in every direction of `yaws_deg` at every one of `pitches_deg`, 0 where none is given.
pub fn aimed_views(yaws_deg: &[f64], pitches_deg: &[f64], fov_deg: f64, size: usize) -> Vec<View> {
    let or_level = |angles: &[f64]| if angles.is_empty() { vec![0.0] } else { angles.to_vec() };
    let yaws = or_level(yaws_deg);
    let views_at = |pitch_deg: f64| {
        yaws.iter().map(move |&yaw_deg| View { yaw_deg, pitch_deg, fov_deg, size }).collect::<Vec<_>>()
    };
    or_level(pitches_deg).into_iter().flat_map(views_at).collect()
}

/// The frame of a view: its axes scaled to steps of one pixel at unit distance.
pub(super) struct Camera {
    ahead: Direction,
    step_right: Direction,
    step_down: Direction,
    centre: f64,
}

impl Camera {
    pub(super) fn new(view: &View) -> Self {
        assert!(view.check().is_ok(), "views are checked before they are rendered, found {view:?}");
        let (sin_yaw, cos_yaw) = view.yaw_deg.to_radians().sin_cos();
        let (sin_pitch, cos_pitch) = view.pitch_deg.to_radians().sin_cos();
        let last = (view.size - 1) as f64;
        let step = 2.0 * (view.fov_deg.to_radians() / 2.0).tan() / last;
        Self {
            ahead: [sin_yaw * cos_pitch, sin_pitch, cos_yaw * cos_pitch],
            step_right: [cos_yaw, 0.0, -sin_yaw].map(|v| v * step),
            step_down: [sin_yaw * sin_pitch, -cos_pitch, cos_yaw * sin_pitch].map(|v| v * step),
            centre: last / 2.0,
        }
    }

    /// The ray of row `y`, column `x`; whole numbers are pixel centres.
    pub(super) fn direction(&self, y: f64, x: f64) -> Direction {
        let (down, right) = (y - self.centre, x - self.centre);
        std::array::from_fn(|i| self.ahead[i] + right * self.step_right[i] + down * self.step_down[i])
    }

    /// The change of a ray from one column to the next.
    pub(super) fn step_right(&self) -> Direction {
        self.step_right
    }

    /// The change of a ray from one row to the next.
    pub(super) fn step_down(&self) -> Direction {
        self.step_down
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_yaw_is_taken_at_every_pitch() {
        let aimed = |yaws: &[f64], pitches: &[f64]| -> Vec<[f64; 2]> {
            aimed_views(yaws, pitches, 60.0, 8).iter().map(|view| [view.yaw_deg, view.pitch_deg]).collect()
        };
        assert_eq!(
            aimed(&[-90.0, 90.0], &[10.0, 20.0]),
            [[-90.0, 10.0], [90.0, 10.0], [-90.0, 20.0], [90.0, 20.0]]
        );
        assert_eq!(aimed(&[45.0], &[]), [[45.0, 0.0]]);
        assert_eq!(aimed(&[], &[-30.0]), [[0.0, -30.0]]);
    }

    #[test]
    fn spans_the_field_of_view_between_the_outermost_pixel_centres() {
        let camera = Camera::new(&View { yaw_deg: 0.0, pitch_deg: 0.0, fov_deg: 60.0, size: 11 });
        for (y, x, right_deg, up_deg) in
            [(5.0, 10.0, 30.0, 0.0), (0.0, 5.0, 0.0, 30.0), (10.0, 5.0, 0.0, -30.0)]
        {
            let [dx, dy, dz] = camera.direction(y, x);
            assert!((dx.atan2(dz).to_degrees() - right_deg).abs() < 1e-12);
            assert!((dy.atan2(dz).to_degrees() - up_deg).abs() < 1e-12);
        }
    }

    /// tan 60° is three times tan 30°: a frame of 11 pixels over 60°, and ten more on each side.
    #[test]
    fn a_margin_widens_the_angle_at_the_same_focal_length() {
        let view = View { yaw_deg: 0.0, pitch_deg: 0.0, fov_deg: 60.0, size: 11 };
        assert!((view.fov_with_margin_deg(10) - 120.0).abs() < 1e-12);
        assert!((view.fov_with_margin_deg(0) - 60.0).abs() < 1e-12);
        assert!(view.check_margin(10).is_ok());
        assert!(view.check_margin(200).unwrap_err().to_string().contains("field of view"));
        assert!(view.check_margin(usize::MAX).unwrap_err().to_string().contains("16384"));
    }

    #[test]
    fn spreads_views_evenly_over_yaw_and_pitch() {
        let views = spread_views(18, 90.0, 800);
        for pitch in PITCHES_DEG {
            let mut yaws: Vec<f64> =
                views.iter().filter(|v| v.pitch_deg == pitch).map(|v| v.yaw_deg).collect();
            yaws.sort_by(f64::total_cmp);
            assert_eq!(yaws.len(), 6);
            assert!(yaws.windows(2).all(|pair| (pair[1] - pair[0] - 60.0).abs() < 1e-12), "{yaws:?}");
        }
        assert_eq!((views[0].yaw_deg, views[0].pitch_deg), (0.0, 0.0));
    }

    #[test]
    fn names_the_flag_that_is_out_of_range() {
        let view = View { yaw_deg: 0.0, pitch_deg: 0.0, fov_deg: 90.0, size: 8 };
        assert!(view.check().is_ok());
        for (view, flag) in [
            (View { fov_deg: 180.0, ..view }, "fov"),
            (View { pitch_deg: 91.0, ..view }, "pitch"),
            (View { yaw_deg: f64::NAN, ..view }, "yaw"),
            (View { size: 1, ..view }, "size"),
        ] {
            assert!(view.check().unwrap_err().to_string().starts_with(flag));
        }
    }
}
