//! Puts counts, rates and times into few words.

use udc::core::progress::PIXELS;

const MEGA: f64 = 1e6;

/// How many of how many: `images 3/12`.
pub(super) fn count(unit: &str, done: u64, total: u64) -> String {
    if unit == PIXELS {
        return format!("{:.1}/{:.1} MP", done as f64 / MEGA, total as f64 / MEGA);
    }
    format!("{unit} {done}/{total}")
}

/// How many in a second and how long the rest takes: `1.3/s, 12 s left`; nothing where neither is known.
pub(super) fn rate(unit: &str, per_second: Option<f64>, left: Option<f64>) -> String {
    let Some(per_second) = per_second else { return String::new() };
    let speed = if unit == PIXELS {
        format!("{:.2} MP/s", per_second / MEGA)
    } else if per_second >= 10.0 {
        format!("{per_second:.0}/s")
    } else if per_second >= 1.0 {
        format!("{per_second:.1}/s")
    } else {
        format!("{} each", duration(1.0 / per_second))
    };
    left.map_or(speed.clone(), |left| format!("{speed}, {} left", duration(left)))
}

/// A time in its two largest units.
pub(super) fn duration(seconds: f64) -> String {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped, of work that somebody waits for"
    )]
    let whole = seconds.clamp(0.0, 1e9).round() as u64;
    match whole {
        0..10 => format!("{seconds:.1} s"),
        10..60 => format!("{whole} s"),
        60..3600 => format!("{} min {} s", whole / 60, whole % 60),
        3600..86_400 => format!("{} h {} min", whole / 3600, whole % 3600 / 60),
        _ => format!("{} d {} h", whole / 86_400, whole % 86_400 / 3600),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_two_units() {
        let said = [0.25, 9.96, 59.4, 125.0, 3600.0 * 5.5, 86_400.0 * 9.5].map(duration);
        assert_eq!(said, ["0.2 s", "10 s", "59 s", "2 min 5 s", "5 h 30 min", "9 d 12 h"]);
        assert_eq!(duration(f64::INFINITY), "11574 d 1 h");
    }

    #[test]
    fn rates_are_said_by_the_step_where_steps_are_slow() {
        assert_eq!(rate("images", Some(2.0), Some(75.0)), "2.0/s, 1 min 15 s left");
        assert_eq!(rate("steps", Some(0.1), None), "10 s each");
        assert_eq!(rate("steps", None, None), "");
        assert_eq!(
            (count("images", 3, 12), count(PIXELS, 2_000_000, 8_000_000)),
            ("images 3/12".into(), "2.0/8.0 MP".into())
        );
        assert_eq!(rate(PIXELS, Some(1.5e6), Some(2.0)), "1.50 MP/s, 2.0 s left");
    }
}
