//! What a page's viewer shows, and how it stands in the page: scenes of pictures, each a compressed still with the light of
//! every pixel as half floats where the page has room for it.

use std::fmt::Write as _;

use data_encoding::BASE64;
use serde_json::{Value, json};

use super::page::{escape, open_fold, write_image};
use crate::core::tone::ToneCurve;

/// Pictures to compare under one divider, scene by scene.
#[derive(Clone, Debug, Default)]
pub struct Viewer {
    /// The scenes, in the order in which they are chosen from.
    pub scenes: Vec<Scene>,
    /// The curve that light is shown by at first.
    pub shown_by: ShownBy,
    /// What the fold of stills is called.
    pub stills: String,
}

/// How light becomes display values; the order is that of the script's curves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ShownBy {
    /// The tone mapping φ, shown as it is.
    #[default]
    ToneMapping,
    /// The curve of sRGB, white at 1.
    Srgb,
}

/// Pictures of one size, of one scene.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Its name.
    pub name: String,
    /// Height and width of its pictures.
    pub size: [usize; 2],
    /// The curve of tone-mapped values.
    pub curve: ToneCurve,
    /// Its pictures, in the order of the keys that choose them.
    pub pictures: Vec<ViewedPicture>,
    /// Which picture the others are to be like, where there is one.
    pub reference: Option<usize>,
    /// Its regions as a PNG, if they are known: 255 highlights, 128 flare, 0 the rest.
    pub regions: Option<Vec<u8>>,
    /// What is to be known of its pictures; empty for nothing.
    pub note: String,
}

/// A picture of a scene.
#[derive(Clone, Debug)]
pub struct ViewedPicture {
    /// Its name.
    pub name: String,
    /// The picture as a JPEG or PNG file: at full resolution and tone-mapped, unless there is `light`.
    pub still: Vec<u8>,
    /// Its light as half floats, little-endian, red, green and blue of each pixel after each other, row by row.
    pub light: Option<Vec<u8>>,
    /// What is to be known of it; empty for nothing.
    pub note: String,
}

impl ShownBy {
    fn place(self) -> usize {
        match self {
            Self::ToneMapping => 0,
            Self::Srgb => 1,
        }
    }
}

impl Viewer {
    /// Writes the data of the viewer and its stills, which the script takes the compressed pictures from; `number` tells
    /// the viewers of a page apart.
    ///
    /// # Errors
    /// None: writing to a string cannot fail.
    pub(super) fn write(&self, html: &mut String, number: usize) -> std::fmt::Result {
        let data = json!({
            "curve": self.shown_by.place(),
            "scenes": self.scenes.iter().enumerate().map(|(at, scene)| scene.data(number, at)).collect::<Vec<_>>(),
        });
        writeln!(
            html,
            "<div class=\"viewer\"><script type=\"application/json\">{}</script></div>",
            in_script(&data)
        )?;
        open_fold(html, &self.stills)?;
        for (at, scene) in self.scenes.iter().enumerate() {
            scene.write_stills(html, number, at)?;
        }
        html.push_str("</details>\n");
        for (at, scene) in self.scenes.iter().enumerate() {
            scene.write_light(html, number, at)?;
        }
        Ok(())
    }
}

impl Scene {
    fn data(&self, number: usize, at: usize) -> Value {
        let picture = |(index, picture): (usize, &ViewedPicture)| {
            json!({
                "name": picture.name,
                "note": picture.note,
                "image": still_id(number, at, index),
                "half": picture.light.is_some().then(|| light_id(number, at, index)),
            })
        };
        let [height, width] = self.size;
        json!({
            "name": self.name,
            "width": width,
            "height": height,
            "tone": { "alpha": self.curve.alpha, "xMax": self.curve.x_max },
            "note": self.note,
            "pictures": self.pictures.iter().enumerate().map(picture).collect::<Vec<_>>(),
            "reference": self.reference,
            "regions": self.regions.is_some().then(|| regions_id(number, at)),
        })
    }

    fn write_stills(&self, html: &mut String, number: usize, at: usize) -> std::fmt::Result {
        html.push_str("<div class=\"figures\">\n");
        for (index, picture) in self.pictures.iter().enumerate() {
            let caption = escape(&format!("{}: {}", self.name, picture.name));
            let attributes = format!("id=\"{}\" alt=\"{caption}\"", still_id(number, at, index));
            html.push_str("<figure>");
            write_image(html, &attributes, &picture.still)?;
            writeln!(html, "<figcaption>{caption}</figcaption></figure>")?;
        }
        html.push_str("</div>\n");
        if let Some(regions) = &self.regions {
            write_image(html, &format!("id=\"{}\" alt=\"\" hidden", regions_id(number, at)), regions)?;
        }
        Ok(())
    }

    fn write_light(&self, html: &mut String, number: usize, at: usize) -> std::fmt::Result {
        for (index, picture) in self.pictures.iter().enumerate() {
            if let Some(light) = &picture.light {
                // A kind of script that no browser runs: text that is not laid out.
                write!(html, "<script type=\"text/plain\" id=\"{}\">", light_id(number, at, index))?;
                BASE64.encode_append(light, html);
                html.push_str("</script>\n");
            }
        }
        Ok(())
    }
}

fn still_id(viewer: usize, scene: usize, picture: usize) -> String {
    format!("still-{viewer}-{scene}-{picture}")
}

fn light_id(viewer: usize, scene: usize, picture: usize) -> String {
    format!("light-{viewer}-{scene}-{picture}")
}

fn regions_id(viewer: usize, scene: usize) -> String {
    format!("regions-{viewer}-{scene}")
}

/// JSON that cannot end the element that it stands in, whatever its texts are.
fn in_script(data: &Value) -> String {
    data.to_string().replace('<', "\\u003c")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn viewer(name: &str) -> Viewer {
        let picture = |name: &str, light: Option<Vec<u8>>| ViewedPicture {
            name: name.to_owned(),
            still: vec![0xff, 0xd8, 1],
            light,
            note: String::new(),
        };
        let scene = Scene {
            name: name.to_owned(),
            size: [1, 1],
            curve: ToneCurve::default(),
            pictures: vec![picture("a", Some(vec![0, 60, 0, 60, 0, 60])), picture("b", None)],
            reference: Some(1),
            regions: Some(vec![1, 2]),
            note: String::new(),
        };
        Viewer { scenes: vec![scene], ..Viewer::default() }
    }

    fn written(viewer: &Viewer) -> String {
        let mut html = String::new();
        viewer.write(&mut html, 7).unwrap();
        html
    }

    #[test]
    fn every_picture_of_the_data_stands_in_the_page() {
        let html = written(&viewer("scene"));
        let (_, rest) = html.split_once("application/json\">").unwrap();
        let data: Value = serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap();
        let scene = &data["scenes"][0];
        for id in [&scene["pictures"][0]["half"], &scene["pictures"][1]["image"], &scene["regions"]] {
            assert!(html.contains(&format!("id=\"{}\"", id.as_str().unwrap())), "{id}");
        }
        assert!(scene["pictures"][1]["half"].is_null());
        assert!(
            html.contains("data:image/jpeg;base64,/9gB") && html.contains(">ADwAPAA8</script>"),
            "{html}"
        );
    }

    #[test]
    fn a_name_ends_neither_the_data_nor_an_attribute() {
        let html = written(&viewer("</script><img src=x onerror=\"a()\">"));
        assert!(!html.contains("<img src=x") && html.matches("</script>").count() == 2, "{html}");
    }
}
