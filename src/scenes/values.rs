//! Numbers that look random and depend on their place alone.

/// Value noise in `[0, 1]`: random values on the integer grid, interpolated smoothly.
pub(super) fn smooth_noise(x: f32, y: f32, seed: u32) -> f32 {
    let (cell_x, cell_y) = (x.floor(), y.floor());
    let ease = |t: f32| t * t * (3.0 - 2.0 * t);
    let (tx, ty) = (ease(x - cell_x), ease(y - cell_y));
    let corner = |dx: f32, dy: f32| hash_to_unit(cell_x + dx, cell_y + dy, seed);
    let above = corner(0.0, 0.0) + (corner(1.0, 0.0) - corner(0.0, 0.0)) * tx;
    let below = corner(0.0, 1.0) + (corner(1.0, 1.0) - corner(0.0, 1.0)) * tx;
    above + (below - above) * ty
}

/// A well-mixed number in `[0, 1)` for a grid point.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "grid indices are small integers"
)]
pub(super) fn hash_to_unit(x: f32, y: f32, seed: u32) -> f32 {
    let mut bits = i64::from(x as i32).wrapping_mul(0x9E37_79B9_7F4A_7C15_u64.cast_signed())
        ^ i64::from(y as i32).wrapping_mul(0xC2B2_AE3D_27D4_EB4F_u64.cast_signed())
        ^ i64::from(seed).wrapping_mul(0x1656_67B1_9E37_79F9);
    bits ^= bits.cast_unsigned().wrapping_shr(29).cast_signed();
    bits = bits.wrapping_mul(0xBF58_476D_1CE4_E5B9_u64.cast_signed());
    (bits.cast_unsigned() >> 40) as f32 / (1u64 << 24) as f32
}
