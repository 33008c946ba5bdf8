//! Where the samples of a plane around a frame lie.

/// An axis of a plane: behind the frame come its surroundings, those that follow it and those that precede it.
#[derive(Clone, Copy)]
pub(super) struct PlaneAxis {
    pub(super) frame: usize,
    pub(super) plane: usize,
}

impl PlaneAxis {
    /// The place of a sample, the frame's first being 0.
    pub(super) fn offset(self, index: usize) -> isize {
        let following = (self.plane - self.frame).div_ceil(2);
        if index < self.frame + following {
            index.cast_signed()
        } else {
            index.cast_signed() - self.plane.cast_signed()
        }
    }

    /// The sample of a place, if the plane has it.
    pub(super) fn index(self, offset: isize) -> Option<usize> {
        let index = if offset < 0 { offset + self.plane.cast_signed() } else { offset };
        usize::try_from(index).ok().filter(|index| *index < self.plane && self.offset(*index) == offset)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_of_a_plane_have_their_places_around_the_frame() {
        for (frame, plane) in [(5, 5), (5, 9), (5, 10), (4, 7)] {
            let axis = PlaneAxis { frame, plane };
            let offsets: Vec<_> = (0..plane).map(|index| axis.offset(index)).collect();
            assert_eq!(offsets[..frame], (0..frame.cast_signed()).collect::<Vec<_>>());
            assert!(offsets.iter().enumerate().all(|(index, offset)| axis.index(*offset) == Some(index)));
            let [before, after] = [offsets.iter().min(), offsets.iter().max()].map(|most| most.unwrap());
            assert_eq!(after - before + 1, plane.cast_signed());
            assert!(axis.index(before - 1).is_none() && axis.index(after + 1).is_none());
        }
    }
}
