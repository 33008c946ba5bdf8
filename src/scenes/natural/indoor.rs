//! Rooms seen against their windows and lamps: large bright rectangles, furniture, shelves, pictures.

use super::draw::Draw;
use super::easel::{CLIPPING, Easel};
use super::lettering::{Alphabet, Type};
use super::light::{Rgb, glowing, hue, luminance, reflectance, scale, tint};
use super::outline;
use super::surface::Surface;

/// `[left, top, right, bottom]` in pixels.
type Box = [f32; 4];

pub(super) fn paint(easel: &mut Easel) {
    let [height, _] = easel.film.size();
    let floor = height * easel.draw.uniform(0.65, 0.88);
    let wall = scale(&hue(easel.draw.uniform(0.0, 1.6), easel.draw.uniform(0.0, 0.3)), 0.4);
    wallpaper(easel, wall);
    ceiling_and_floor(easel, floor);
    for _ in 0..easel.draw.count(1, 5) {
        picture(easel, floor);
    }
    for _ in 0..easel.draw.count(0, 2) {
        shelf(easel, floor);
    }
    let windows = windows(easel, floor);
    for _ in 0..easel.draw.count(2, 9) {
        furniture(easel, floor);
    }
    spread_light(easel, &windows);
    easel.expose(0.06, 0.3);
    let day = if easel.draw.chance(0.75) { easel.draw.log(20.0, 100.0) } else { easel.draw.log(1.0, 12.0) };
    let level = day * easel.film.median().max(0.05);
    for window in &windows {
        view(easel, *window, level);
    }
    fixtures(easel, floor);
}

/// Plaster, or stripes or dots on it.
fn wallpaper(easel: &mut Easel, wall: Rgb) {
    let roughness = easel.draw.log(0.08, 0.35);
    let plaster = Surface::grainy(&mut easel.draw, wall, roughness);
    easel.prime(&plaster);
    if easel.draw.chance(0.35) {
        let (kind, period) = (easel.draw.pick(&[0, 1, 3]), easel.draw.log(4.0, 40.0));
        let second = easel.draw.uniform(0.5, 0.9);
        let pattern = Surface::patterned([[1.0; 3], [second; 3]], kind, period, 0.0);
        let grain = &easel.grain;
        easel.film.all(|at, sample| *sample = tint(sample, &pattern.at(at, grain)));
    }
}

/// Boards or tiles in perspective, and a lighter ceiling.
fn ceiling_and_floor(easel: &mut Easel, floor: f32) {
    let [height, width] = easel.film.size();
    let ceiling = floor * easel.draw.uniform(0.0, 0.18);
    easel.shine(&outline::rectangle([0.0, 0.0, width, ceiling]), [0.62, 0.61, 0.58]);
    let wood = scale(&hue(0.45, 0.55), easel.draw.log(0.05, 0.3));
    let ground = Surface::grainy(&mut easel.draw, wood, 0.2);
    easel.paint(&outline::rectangle([0.0, floor, width, height]), &ground);
    let (vanishing, gap) = (easel.draw.uniform(0.2, 0.8) * width, easel.draw.log(0.03, 0.12) * width);
    let dark = scale(&wood, 0.35);
    for i in -40i16..40 {
        let near = vanishing + f32::from(i) * 3.0 * gap;
        let far = vanishing + f32::from(i) * gap;
        easel.shine(&outline::stroke([far, floor], [near, height], [0.5, 1.6]), dark);
    }
    easel.shine(&outline::rectangle([0.0, floor - 0.015 * height, width, floor]), [0.5, 0.49, 0.47]);
}

fn rectangle(draw: &mut Draw, [height, width]: [f32; 2], sides: [f32; 2], floor: f32) -> Box {
    let (w, h) = (width * draw.log(sides[0], sides[1]), height * draw.log(sides[0], sides[1]));
    let (x, y) = (draw.uniform(-0.1 * w, width - 0.9 * w), draw.uniform(0.05, 0.75) * (floor - h).max(1.0));
    [x, y, x + w, y + h]
}

fn picture(easel: &mut Easel, floor: f32) {
    let size = easel.film.size();
    let frame = rectangle(&mut easel.draw, size, [0.08, 0.3], floor);
    let margin = 0.03 * (frame[2] - frame[0]) + 1.0;
    let wood = reflectance(&mut easel.draw);
    easel.shine(&outline::rectangle(frame), scale(&wood, 0.4));
    let inner = [frame[0] + margin, frame[1] + margin, frame[2] - margin, frame[3] - margin];
    let colours = [reflectance(&mut easel.draw), reflectance(&mut easel.draw)];
    let canvas = Surface::grainy(&mut easel.draw, colours[0], 0.7);
    easel.paint(&outline::rectangle(inner), &canvas);
    if easel.draw.chance(0.5) {
        let alphabet = Alphabet::new(&mut easel.draw);
        let height = (0.12 * (inner[3] - inner[1])).clamp(4.0, 30.0);
        let style = Type { height, weight: 0.13 * height, angle: 0.0, ink: colours[1] };
        let mut y = inner[1] + 0.3 * height;
        while y + height < inner[3] {
            alphabet.write(easel, [inner[0] + 0.3 * height, y], inner[2] - inner[0] - 0.6 * height, style);
            y += 1.7 * height;
        }
    }
}

/// Books side by side on several boards.
fn shelf(easel: &mut Easel, floor: f32) {
    let size = easel.film.size();
    let [left, top, right, bottom] = rectangle(&mut easel.draw, size, [0.15, 0.5], floor);
    let wood = scale(&hue(0.45, 0.5), 0.15);
    easel.shine(&outline::rectangle([left, top, right, bottom]), scale(&wood, 0.3));
    let rows = easel.draw.count(2, 6);
    let pitch = (bottom - top) / rows as f32;
    for row in 0..rows {
        let board = top + pitch * (row + 1) as f32;
        let mut x = left + 1.0;
        while x < right - 2.0 {
            let (thick, tall) =
                (easel.draw.log(1.5, 9.0).min(right - x), pitch * easel.draw.uniform(0.55, 0.92));
            let colour = reflectance(&mut easel.draw);
            easel.shine(&outline::rectangle([x, board - tall, x + thick, board]), colour);
            if thick > 3.0 && easel.draw.chance(0.5) {
                let title = [x + 0.3 * thick, board - 0.8 * tall, x + 0.7 * thick, board - 0.4 * tall];
                let print = reflectance(&mut easel.draw);
                easel.shine(&outline::rectangle(title), print);
            }
            x += thick + easel.draw.uniform(0.0, 0.8);
        }
        easel.shine(&outline::rectangle([left, board, right, board + 0.06 * pitch + 1.0]), wood);
    }
}

fn furniture(easel: &mut Easel, floor: f32) {
    let [height, width] = easel.film.size();
    let draw = &mut easel.draw;
    let (w, h) = (width * draw.log(0.08, 0.45), height * draw.log(0.05, 0.3));
    let (x, bottom) = (draw.uniform(-0.1, 0.95) * width, floor + draw.uniform(0.1, 0.9) * (height - floor));
    let colours = [reflectance(draw), reflectance(draw)];
    let centre = [x + 0.5 * w, bottom - 0.5 * h];
    let surface = Surface::draw(draw, colours, centre, 0.5 * w.min(h));
    easel.shadow([centre[0], bottom], 0.45 * w, 0.6);
    match easel.draw.count(0, 2) {
        0 => {
            let thick = (0.06 * h).max(1.5);
            for leg in [x, x + w - thick] {
                easel.paint(&outline::rectangle([leg, bottom - h, leg + thick, bottom]), &surface.lit(0.6));
            }
            easel.paint(
                &outline::rectangle([x - 2.0, bottom - h, x + w + 2.0, bottom - h + 1.5 * thick]),
                &surface,
            );
        }
        1 => easel.paint(&outline::ellipse(centre, [0.5 * w, 0.5 * h], 0.0), &surface),
        _ => easel.paint(&outline::rectangle([x, bottom - h, x + w, bottom]), &surface),
    }
}

/// Places windows, one or two of 20 to 100 pixels and more, which together are small enough for what may clip.
fn windows(easel: &mut Easel, floor: f32) -> Vec<Box> {
    let [height, width] = easel.film.size();
    let count = easel.draw.count(0, 3);
    let side = easel.side();
    let mut area = 0.14 * height * width;
    let mut windows = Vec::new();
    for _ in 0..count {
        let draw = &mut easel.draw;
        let (w, h) = (draw.log(20.0, 0.35 * side.max(60.0)), draw.log(20.0, 0.45 * side.max(45.0)));
        area -= w * h;
        if area < 0.0 {
            break;
        }
        let (x, y) =
            (draw.uniform(-0.2 * w, width - 0.8 * w), draw.uniform(0.08, 0.9) * (floor - h).max(1.0));
        windows.push([x, y, x + w, y + h]);
    }
    windows
}

/// Multiplies the room by the light from its windows and lamps.
fn spread_light(easel: &mut Easel, windows: &[Box]) {
    let ambient = scale(&glowing(easel.draw.log(2700.0, 5000.0), 4500.0), easel.draw.log(0.1, 0.6));
    let day = glowing(easel.draw.log(5000.0, 9000.0), 5000.0);
    let corner = easel.draw.point(easel.film.size(), 0.0);
    let reach = 0.35 * easel.side();
    easel.film.all(|[x, y], sample| {
        let dark = ((x - corner[0]).hypot(y - corner[1]) / (2.0 * reach)).min(2.0);
        let mut light = scale(&ambient, 1.3 - 0.5 * dark);
        for [left, top, right, bottom] in windows {
            let dx = (left - x).max(x - right).max(0.0) / reach;
            let dy = (top - y).max(y - bottom).max(0.0) / reach;
            let share = (1.0 + dx * dx + dy * dy).powi(-2);
            (0..light.len()).for_each(|c| light[c] += 0.9 * share * day[c]);
        }
        *sample = tint(sample, &light);
    });
}

/// What is seen through a window: sky over trees, with frames in front.
fn view(easel: &mut Easel, [left, top, right, bottom]: Box, level: f32) {
    let sky = scale(&hue(4.0, easel.draw.uniform(0.0, 0.3)), level);
    let area = outline::rectangle([left, top, right, bottom]);
    let air = Surface::grainy(&mut easel.draw, sky, 0.08);
    easel.paint(&area, &air);
    if easel.draw.chance(0.7) {
        let line = top + (bottom - top) * easel.draw.uniform(0.3, 0.9);
        let (seed, rough) = (easel.draw.uniform(0.0, 256.0), 0.1 * (bottom - top));
        let green = scale(&hue(2.0, 0.5), level * easel.draw.log(0.05, 0.4));
        let trees = Surface::grainy(&mut easel.draw, green, 0.6);
        let grain = &easel.grain;
        easel.film.fill(&area, |at, sample| {
            if at[1] > line + rough * grain.at(0.6 * at[0] + seed, seed) {
                *sample = trees.at(at, grain);
            }
        });
    }
    let frame = scale(&[1.0, 0.98, 0.95], easel.draw.log(0.02, 0.5));
    let thick = (0.02 * (right - left)).max(1.0);
    let bars = |from: f32, to: f32, count: usize| {
        (0..=count).map(move |i| from + (to - from) * i as f32 / count as f32).collect::<Vec<_>>()
    };
    for x in bars(left, right, easel.draw.count(1, 4)) {
        easel.shine(&outline::rectangle([x - thick, top, x + thick, bottom]), frame);
    }
    for y in bars(top, bottom, easel.draw.count(1, 4)) {
        easel.shine(&outline::rectangle([left - thick, y - thick, right + thick, y + thick]), frame);
    }
    if easel.draw.chance(0.25) {
        blinds(easel, [left, top, right, bottom], frame);
    }
}

fn blinds(easel: &mut Easel, [left, top, right, bottom]: Box, colour: Rgb) {
    let pitch = easel.draw.log(3.0, 9.0);
    let low = top + (bottom - top) * easel.draw.uniform(0.3, 1.0);
    let mut y = top;
    while y < low {
        easel.shine(&outline::rectangle([left, y, right, y + 0.55 * pitch]), colour);
        y += pitch;
    }
}

/// Ceiling panels, rows of spots, shaded lamps, screens.
fn fixtures(easel: &mut Easel, floor: f32) {
    let [_, width] = easel.film.size();
    let side = easel.side();
    for _ in 0..easel.draw.count(0, 3) {
        let draw = &mut easel.draw;
        let colour = glowing(draw.log(2500.0, 5500.0), 4500.0);
        let [x, y] = [draw.uniform(0.02, 0.95) * width, draw.uniform(0.01, 0.3) * floor];
        match draw.count(0, 3) {
            0 => {
                let (w, h) = (side * draw.log(0.06, 0.25), side * draw.log(0.01, 0.05));
                let panel = scale(&colour, draw.log(5.0, 100.0));
                easel.glow([x + 0.5 * w, y], w, scale(&colour, 0.1));
                easel.shine(&outline::stroke([x, y], [x + w, y + 0.1 * w], [h, h]), panel);
            }
            1 => {
                let (count, gap) = (draw.count(2, 7), side * draw.log(0.03, 0.12));
                let (radius, spot) = (draw.log(0.6, 4.0), scale(&colour, draw.log(100.0, 3e4)));
                (0..count).for_each(|i| easel.lamp([x + gap * i as f32, y], radius, spot));
            }
            2 => {
                let size = side * draw.log(0.02, 0.08);
                let shade = scale(&colour, draw.log(1.0, CLIPPING));
                let bulb = scale(&colour, draw.log(100.0, 1e4));
                let low = y + 0.45 * floor;
                easel.glow([x, low], 4.0 * size, scale(&colour, 0.4));
                let hood = [
                    [x - 0.5 * size, low - size],
                    [x + 0.5 * size, low - size],
                    [x + size, low],
                    [x - size, low],
                ];
                easel.shine(&hood, shade);
                easel.lamp([x, low], (0.2 * size).max(0.7), bulb);
            }
            _ => screen(easel, [x, y + 0.5 * floor], side),
        }
    }
}

/// A lit display with lines of text.
fn screen(easel: &mut Easel, [x, y]: [f32; 2], side: f32) {
    let (w, h) = (side * easel.draw.log(0.1, 0.3), side * easel.draw.log(0.07, 0.2));
    let paper = scale(&hue(4.0, easel.draw.uniform(0.0, 0.4)), easel.draw.log(0.5, 6.0));
    easel.shine(&outline::rectangle([x - 2.0, y - 2.0, x + w + 2.0, y + h + 2.0]), [0.01; 3]);
    easel.shine(&outline::rectangle([x, y, x + w, y + h]), paper);
    let alphabet = Alphabet::new(&mut easel.draw);
    let ink = scale(&paper, 0.1 / luminance(&paper).max(0.1));
    let style = Type { height: 5.0, weight: 0.8, angle: 0.0, ink };
    let mut row = y + 4.0;
    while row + 6.0 < y + h {
        let length = w * easel.draw.uniform(0.3, 0.9);
        alphabet.write(easel, [x + 4.0, row], length, style);
        row += 9.0;
    }
}
