//! Analytic truth: irregular panels. Displacements take light out of the orders and spread it between them.

use std::f64::consts::PI;

use udc::psf::display::{IrregularityConfig, LayoutConfig, LayoutKind, RegionConfig};
use udc::psf::layout::UnitCell;
use udc::psf::orders::Orders;

const PITCH_UM: f64 = 60.0;
const SIDE_UM: f64 = 12.0;
const JITTER_UM: f64 = 4.0;
/// Pixels along a side of what repeats; that many squared displacements are drawn.
const PIXELS: usize = 8;
const BAND_PER_M: f64 = 70e3;

/// Opaque but for one square opening in each pixel, displaced by `jitter_um`.
fn orders(seed: u64, jitter_um: f64) -> Orders {
    let layout = LayoutConfig {
        kind: LayoutKind::Stripe,
        pitch_um: Some(PITCH_UM),
        background_transmittance: Some(0.0),
        green: Some(RegionConfig {
            width_um: SIDE_UM,
            height_um: SIDE_UM,
            transmittance: 1.0,
            ..RegionConfig::default()
        }),
        irregularity: Some(IrregularityConfig { pixels: PIXELS, seed, jitter_um, size_spread: 0.0 }),
        ..LayoutConfig::default()
    };
    Orders::of(&UnitCell::of(&layout, BAND_PER_M).unwrap(), BAND_PER_M)
}

/// The light of the order at (row, column) of the square that repeats.
fn light_at(orders: &Orders, [row, column]: [i32; 2]) -> f64 {
    let step = 1e6 / (PIXELS as f64 * PITCH_UM);
    let is_there = |found: f64, order: i32| (found / step - f64::from(order)).abs() < 0.5;
    orders.clone().retain(|y, x| is_there(y, row) && is_there(x, column)).power()
}

/// What an order of the regular panel holds, at any frequency: (a/p)⁴ sinc²(aν) along both axes.
fn regular([row, column]: [i32; 2]) -> f64 {
    let sinc = |order: i32| {
        let x = PI * SIDE_UM * f64::from(order) / (PIXELS as f64 * PITCH_UM);
        if order == 0 { 1.0 } else { x.sin() / x }
    };
    (SIDE_UM / PITCH_UM).powi(4) * (sinc(row) * sinc(column)).powi(2)
}

/// exp(−4π²σ²ν²), the share that order keeps (Debye and Waller).
fn kept([row, column]: [i32; 2]) -> f64 {
    let squared = f64::from(row * row + column * column) / (PIXELS as f64 * PITCH_UM).powi(2);
    (-4.0 * PI * PI * JITTER_UM.powi(2) * squared).exp()
}

#[test]
fn without_displacement_nothing_is_between_the_orders() {
    let orders = orders(1, 0.0);
    for place in [[0, 8], [16, 0], [8, 24]] {
        let found = light_at(&orders, place) / regular(place);
        // The raster's aliases, at 1/16 of the coefficients' size at the end of the band, less at lower orders.
        assert!((found - 1.0).abs() < 0.03, "{place:?}: {found}");
    }
    for place in [[0, 4], [3, 5]] {
        let found = light_at(&orders, place);
        // Amplitudes are rounded to some 10⁻⁶ of the open area, as the edges of the squares that draw it.
        assert!(found < 1e-11, "{place:?}: {found:e}");
    }
}

/// Of M displacements, an order keeps q + (1 − q)/M in the mean. One panel scatters by √(2(1 − q)²/(Mq)) of it at most, 35 %
/// for the third order; 48 of them, along two axes, to 3.6 %.
#[test]
fn gaussian_displacements_dim_the_orders_as_heat_does_a_crystals() {
    let panels: Vec<Orders> = (0..48).map(|seed| orders(seed, JITTER_UM)).collect();
    for order in 1..=3 {
        let places = [[0, 8 * order], [8 * order, 0]];
        let sum: f64 = panels.iter().flat_map(|panel| places.map(|place| light_at(panel, place))).sum();
        let found = sum / 96.0 / regular(places[0]);
        let q = kept(places[0]);
        let expected = q + (1.0 - q) / (PIXELS * PIXELS) as f64;
        assert!((found / expected - 1.0).abs() < 0.15, "order {order}: {found} instead of {expected}");
    }
}

/// Each of the places between orders holds (1 − q)/M of what an order there would: speckle, summed over a thousand
/// independent ones in each of four panels, to 2 % (four standard deviations: 8 %).
#[test]
fn what_the_orders_lose_spreads_between_them() {
    let reach = 24;
    let step = 1e6 / (PIXELS as f64 * PITCH_UM);
    let near = |value: f64| (value / step).round() as i32;
    let between =
        |row: i32, column: i32| (row % 8 != 0 || column % 8 != 0) && row.abs().max(column.abs()) <= reach;
    let found: f64 = (0..4)
        .map(|seed| orders(seed, JITTER_UM).retain(|y, x| between(near(y), near(x))).power())
        .sum::<f64>()
        / 4.0;
    let places = (-reach..=reach).flat_map(|row| (-reach..=reach).map(move |column| [row, column]));
    let expected: f64 = places
        .filter(|[row, column]| between(*row, *column))
        .map(|place| regular(place) * (1.0 - kept(place)) / (PIXELS * PIXELS) as f64)
        .sum();
    assert!((found / expected - 1.0).abs() < 0.08, "{found} instead of {expected}");
}
