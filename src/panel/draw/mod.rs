//! The panel's widgets: functions of [`PanelData`]. What a user asks for comes back as [`PanelRequest`]s.

pub(crate) mod frames;
pub(crate) mod scatter;
pub(crate) mod tables;

use bevy_egui::egui::{
    Align2, Color32, Context, CornerRadius, FontFamily, FontId, Frame, Margin, Panel, Pos2, Rect,
    RichText, ScrollArea, Sense, Stroke, TextStyle, Theme, Ui, Vec2, pos2, vec2,
};

use super::{
    SkylinePanel,
    data::{PanelData, PanelRequest},
};

/// Behind everything.
const BACK: Color32 = Color32::from_rgb(22, 24, 29);
/// Behind plots.
const WELL: Color32 = Color32::from_rgb(14, 15, 19);
const LINE: Color32 = Color32::from_rgb(52, 57, 66);
const TEXT: Color32 = Color32::from_rgb(224, 227, 232);
const WEAK: Color32 = Color32::from_rgb(152, 159, 170);
/// At work, within the target.
const GREEN: Color32 = Color32::from_rgb(92, 200, 116);
/// Not asked for.
const GREY: Color32 = Color32::from_rgb(128, 134, 144);
/// Nothing to do, or worth a look.
const AMBER: Color32 = Color32::from_rgb(236, 180, 66);
/// Not possible, over the target.
const RED: Color32 = Color32::from_rgb(238, 96, 86);
/// Neither good nor bad.
const BLUE: Color32 = Color32::from_rgb(98, 164, 242);

/// What the widgets keep from frame to frame.
#[derive(bevy::prelude::Resource, Clone, Debug)]
pub struct PanelView {
    /// How wide the panel is. units: logical px
    pub width: f32,
    /// The path that is being typed.
    pub path: String,
    /// The group of results that is shown.
    pub group: usize,
    /// The error field that is shown; `None` for one that tells points apart.
    pub error: Option<usize>,
    /// Whether more of it is better.
    pub more_is_better: bool,
}

impl PanelView {
    /// As the panel was left.
    pub fn new(panel: &SkylinePanel) -> Self {
        let path = panel.results.as_ref();
        Self {
            width: panel.width,
            path: path.map_or_else(String::new, |path| path.display().to_string()),
            group: 0,
            error: None,
            more_is_better: false,
        }
    }
}

/// Colours and sizes of all widgets.
pub(super) fn style(context: &Context) {
    context.set_theme(Theme::Dark);
    context.all_styles_mut(|style| {
        let font = |size| FontId::new(size, FontFamily::Proportional);
        style.text_styles.insert(TextStyle::Heading, font(16.0));
        style.text_styles.insert(TextStyle::Body, font(13.0));
        style.text_styles.insert(TextStyle::Button, font(13.0));
        style.text_styles.insert(TextStyle::Small, font(11.5));
        style.spacing.item_spacing = vec2(8.0, 4.0);
        style.visuals.override_text_color = Some(TEXT);
        style.visuals.weak_text_color = Some(WEAK);
        style.visuals.panel_fill = BACK;
        style.visuals.extreme_bg_color = WELL;
        style.visuals.selection.bg_fill = BLUE.gamma_multiply(0.6);
    });
}

/// The whole panel, on the right of what there is room for. Returns how wide it is, in logical pixels.
pub fn panel(
    ui: &mut Ui,
    data: &PanelData,
    view: &mut PanelView,
    key: &str,
    requests: &mut Vec<PanelRequest>,
) -> f32 {
    let most = (0.8 * ui.available_width()).max(320.0);
    let frame = Frame::NONE
        .fill(BACK)
        .inner_margin(Margin::symmetric(12, 8));
    let shown = Panel::right("skyline panel")
        .default_size(view.width)
        .size_range(320.0..=most)
        .frame(frame)
        .show(ui, |ui| {
            head(ui, data, key);
            ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                frames::frames(ui, data);
                tables::effects(ui, data);
                tables::knobs(ui, data, requests);
                tables::counts(ui, data);
                scatter::scatter(ui, data, view, requests);
                ui.add_space(8.0);
            });
        });
    shown.response.rect.width()
}

/// The name, what the panel costs, how to close it.
fn head(ui: &mut Ui, data: &PanelData, key: &str) {
    let (rect, response) = row(ui, 22.0);
    text(
        ui,
        rect.left_center(),
        Align2::LEFT_CENTER,
        "Skyline",
        16.0,
        TEXT,
    );
    let own = data.own;
    let cost = format!("this panel {:.2} ms{key}", own.total_ms());
    text(
        ui,
        rect.right_center(),
        Align2::RIGHT_CENTER,
        &cost,
        11.5,
        WEAK,
    );
    response.on_hover_text(format!(
        "On the CPU: gathering {:.2} ms, drawing {:.2} ms. Its pass on the GPU is not measured.",
        own.gather_ms, own.draw_ms
    ));
}

/// The title of a part, with a line under it.
fn heading(ui: &mut Ui, title: &str, right: &str) {
    ui.add_space(8.0);
    let (rect, _) = row(ui, 18.0);
    text(
        ui,
        rect.left_center(),
        Align2::LEFT_CENTER,
        title,
        13.0,
        BLUE,
    );
    text(
        ui,
        rect.right_center(),
        Align2::RIGHT_CENTER,
        right,
        11.5,
        WEAK,
    );
    ui.painter()
        .hline(rect.x_range(), rect.bottom(), Stroke::new(1.0, LINE));
    ui.add_space(2.0);
}

/// Room for a line across the panel.
fn row(ui: &mut Ui, height: f32) -> (Rect, bevy_egui::egui::Response) {
    ui.allocate_exact_size(vec2(ui.available_width(), height), Sense::hover())
}

fn text(ui: &Ui, at: Pos2, align: Align2, text: &str, size: f32, colour: Color32) {
    ui.painter()
        .text(at, align, text, FontId::proportional(size), colour);
}

/// A figure that ends `from_right` pixels before a row's end: figures of a column stand below each other.
fn figure(ui: &Ui, row: Rect, from_right: f32, text: &str, colour: Color32) {
    let at = pos2(row.right() - from_right, row.center().y);
    ui.painter().text(
        at,
        Align2::RIGHT_CENTER,
        text,
        FontId::monospace(11.5),
        colour,
    );
}

/// A remark that wraps.
fn remark(ui: &mut Ui, words: &str, colour: Color32, indent: i8) {
    let margin = Margin {
        left: indent,
        ..Margin::ZERO
    };
    Frame::NONE.inner_margin(margin).show(ui, |ui| {
        ui.label(RichText::new(words).small().color(colour));
    });
}

/// A dark field to plot in.
fn well(ui: &mut Ui, height: f32) -> (Rect, bevy_egui::egui::Response) {
    let (rect, response) = row(ui, height);
    ui.painter().rect_filled(rect, CornerRadius::same(3), WELL);
    (rect, response)
}

/// A filled circle and some space, as legends have.
fn dot(ui: &mut Ui, colour: Color32) {
    let (rect, _) = ui.allocate_exact_size(Vec2::splat(8.0), Sense::hover());
    ui.painter().circle_filled(rect.center(), 3.5, colour);
}

/// A count with its thousands apart.
fn grouped(count: u64) -> String {
    let digits = count.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_stand_apart() {
        let counts = [0, 999, 1_000, 12_345, 1_234_567];
        let texts = ["0", "999", "1,000", "12,345", "1,234,567"];
        assert_eq!(counts.map(grouped), texts);
    }
}
