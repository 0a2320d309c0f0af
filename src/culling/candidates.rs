//! The table of everything that can be removed: one slot an entity, kept up by change, never by full scans.

use std::{collections::VecDeque, sync::Arc};

use bevy::{math::Affine3A, prelude::*};

use super::{
    bits::Bits,
    groups::Groups,
    volume::{LocalBox, Proxy},
};

/// No slot.
pub const NO_SLOT: u32 = u32::MAX;

/// Frames for which a freed slot is not given to another entity: longer than any verdict takes to come back.
const QUARANTINE: u64 = 8;

/// One entity that can be removed.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// Whose mesh it is.
    pub entity: Entity,
    /// Its mesh.
    pub mesh: AssetId<Mesh>,
    /// Where it stands.
    pub world_from_local: Affine3A,
    /// What stands for it.
    pub volume: LocalBox,
    /// Another box that encloses it, along other axes, where one is asked for and ready.
    pub turned: Option<LocalBox>,
    /// Its thickened simplified mesh, where one is asked for and ready.
    pub proxy: Option<Arc<Proxy>>,
    /// Triangles of its mesh.
    pub triangles: u32,
    /// What may remove it.
    pub by: CullableBy,
}

/// What may remove an entity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CullableBy {
    /// [`ZBufferOcclusion`](crate::occlusion::ZBufferOcclusion).
    pub occlusion: bool,
    /// [`ContributionCulling`](crate::contribution::ContributionCulling).
    pub contribution: bool,
}

/// Every entity that a camera of this suite may remove. Empty while no camera asks for culling.
#[derive(Resource, Default)]
pub struct Candidates {
    slots: Vec<Option<Candidate>>,
    /// Slots of what the depth buffer may remove, and of what may be removed for covering too little.
    occludable: Bits,
    weighable: Bits,
    /// The entity of each slot, by itself so that looking a slot up stays in the cache; a placeholder's in free ones.
    entities: Vec<Entity>,
    /// Slot of an entity by its index; whether it is that entity's and not an older one's, `slots` says.
    slot_of_index: Vec<u32>,
    free: VecDeque<(u64, u32)>,
    /// Slots whose entity, place or volume changed since the last [`begin`](Self::begin).
    dirty: Vec<u32>,
    is_dirty: Vec<bool>,
    /// Slots given to an entity since the last [`begin`](Self::begin).
    assigned: Vec<u32>,
    frame: u64,
    /// How often everything was forgotten: slots of other epochs are others'.
    epoch: u32,
    /// Time that keeping it up took this frame. units: ms
    pub(crate) update_ms: f32,
    /// Whether it follows the scene.
    pub(crate) is_kept: bool,
    /// Groups of candidates, by the entity hierarchy.
    pub(crate) groups: Groups,
}

impl Candidates {
    /// Begins a frame: forgets what changed in the last one.
    pub(crate) fn begin(&mut self) {
        self.frame += 1;
        self.assigned.clear();
        for slot in self.dirty.drain(..) {
            self.is_dirty[slot as usize] = false;
        }
    }

    /// Slots there are, used or not.
    pub fn slots(&self) -> usize {
        self.slots.len()
    }

    /// Entities in the table.
    pub fn len(&self) -> usize {
        self.slots.len() - self.free.len()
    }

    /// Whether no entity is in the table.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Changes when slots are given anew.
    pub fn epoch(&self) -> u32 {
        self.epoch
    }

    /// The slot of an entity.
    pub fn slot(&self, entity: Entity) -> Option<u32> {
        let slot = *self.slot_of_index.get(entity.index_u32() as usize)?;
        (*self.entities.get(slot as usize)? == entity).then_some(slot)
    }

    /// The slot of an entity that [`ZBufferOcclusion`](crate::occlusion::ZBufferOcclusion) may remove.
    pub fn occludable(&self, entity: Entity) -> Option<u32> {
        self.slot(entity)
            .filter(|slot| self.occludable.contains(*slot))
    }

    /// The slot of an entity that [`ContributionCulling`](crate::contribution::ContributionCulling) may remove.
    pub fn weighable(&self, entity: Entity) -> Option<u32> {
        self.slot(entity)
            .filter(|slot| self.weighable.contains(*slot))
    }

    /// What is in a slot.
    pub fn get(&self, slot: u32) -> Option<&Candidate> {
        self.slots.get(slot as usize)?.as_ref()
    }

    /// Everything in the table.
    pub fn iter(&self) -> impl Iterator<Item = (u32, &Candidate)> {
        self.slots
            .iter()
            .enumerate()
            .filter_map(|(slot, candidate)| Some((slot as u32, candidate.as_ref()?)))
    }

    /// Slots that changed since the frame began, freed ones included.
    pub fn dirty(&self) -> &[u32] {
        &self.dirty
    }

    /// Slots given to an entity since the frame began: what was known of them was of another.
    pub fn assigned(&self) -> &[u32] {
        &self.assigned
    }

    /// Brings the groups' bounds up to date.
    pub(crate) fn refresh_groups(&mut self) {
        let mut groups = core::mem::take(&mut self.groups);
        groups.refresh(|slot| self.get(slot));
        self.groups = groups;
    }

    /// Puts an entity in, or changes what is known of it.
    pub(crate) fn insert(&mut self, candidate: Candidate) -> u32 {
        let index = candidate.entity.index_u32() as usize;
        let slot = match self.slot(candidate.entity) {
            Some(slot) => slot,
            None => {
                // An older entity of the same index is gone.
                if let Some(slot) = self.slot_of_index.get(index).copied()
                    && slot != NO_SLOT
                {
                    self.free_slot(slot);
                }
                let slot = match self.free.front() {
                    Some((since, slot)) if since + QUARANTINE < self.frame => {
                        let slot = *slot;
                        self.free.pop_front();
                        slot
                    }
                    _ => {
                        self.slots.push(None);
                        self.entities.push(Entity::PLACEHOLDER);
                        self.is_dirty.push(false);
                        self.slots.len() as u32 - 1
                    }
                };
                if self.slot_of_index.len() <= index {
                    self.slot_of_index.resize(index + 1, NO_SLOT);
                }
                self.slot_of_index[index] = slot;
                self.assigned.push(slot);
                slot
            }
        };
        self.entities[slot as usize] = candidate.entity;
        self.occludable.set(slot, candidate.by.occlusion);
        self.weighable.set(slot, candidate.by.contribution);
        self.slots[slot as usize] = Some(candidate);
        self.mark(slot);
        slot
    }

    /// Moves an entity.
    pub(crate) fn place(&mut self, slot: u32, world_from_local: Affine3A) {
        if let Some(candidate) = &mut self.slots[slot as usize] {
            candidate.world_from_local = world_from_local;
            self.mark(slot);
        }
    }

    /// Changes what stands for an entity.
    pub(crate) fn reshape(
        &mut self,
        slot: u32,
        turned: Option<LocalBox>,
        proxy: Option<Arc<Proxy>>,
    ) {
        if let Some(candidate) = &mut self.slots[slot as usize] {
            candidate.turned = turned;
            candidate.proxy = proxy;
            self.mark(slot);
        }
    }

    /// Takes an entity out.
    pub(crate) fn remove(&mut self, entity: Entity) {
        if let Some(slot) = self.slot(entity) {
            self.slot_of_index[entity.index_u32() as usize] = NO_SLOT;
            self.free_slot(slot);
        }
    }

    /// Takes everything out and frees the memory.
    pub(crate) fn forget(&mut self) {
        *self = Self {
            frame: self.frame,
            epoch: self.epoch.wrapping_add(1),
            ..default()
        };
    }

    fn free_slot(&mut self, slot: u32) {
        if self.slots[slot as usize].take().is_some() {
            self.entities[slot as usize] = Entity::PLACEHOLDER;
            self.occludable.remove(slot);
            self.weighable.remove(slot);
            self.groups.leave(slot);
            self.free.push_back((self.frame, slot));
            self.mark(slot);
        }
    }

    fn mark(&mut self, slot: u32) {
        self.groups.touch(slot);
        if !self.is_dirty[slot as usize] {
            self.is_dirty[slot as usize] = true;
            self.dirty.push(slot);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(entity: Entity) -> Candidate {
        Candidate {
            entity,
            mesh: AssetId::default(),
            world_from_local: Affine3A::IDENTITY,
            volume: LocalBox::default(),
            turned: None,
            proxy: None,
            triangles: 0,
            by: CullableBy {
                occlusion: true,
                contribution: true,
            },
        }
    }

    /// The entity that gets another's index after it.
    fn of_the_same_index(gone: Entity) -> Entity {
        let again =
            Entity::from_index_and_generation(gone.index(), gone.generation().after_versions(1));
        assert_eq!(again.index_u32(), gone.index_u32());
        assert_ne!(again, gone);
        again
    }

    #[test]
    fn an_entitys_slot_is_its_own_and_rests_before_it_is_anothers() {
        let mut world = World::new();
        let [a, b] = [world.spawn_empty().id(), world.spawn_empty().id()];
        let mut table = Candidates::default();
        table.begin();
        let (slot_a, slot_b) = (table.insert(candidate(a)), table.insert(candidate(b)));
        assert_ne!(slot_a, slot_b);
        assert_eq!(table.insert(candidate(a)), slot_a, "known already");
        assert_eq!(table.dirty(), [slot_a, slot_b]);
        table.begin();
        assert!(table.dirty().is_empty());

        table.remove(a);
        assert_eq!((table.slot(a), table.len()), (None, 1));
        assert_eq!(table.dirty(), [slot_a], "what was known of it is void");
        let again = of_the_same_index(a);
        assert_eq!(
            again.index_u32(),
            a.index_u32(),
            "Bevy gives the index again"
        );
        let slot_again = table.insert(candidate(again));
        assert_ne!(slot_again, slot_a, "verdicts on the way are not for it");
        assert_eq!((table.slot(a), table.slot(again)), (None, Some(slot_again)));
        for _ in 0..=QUARANTINE {
            table.begin();
        }
        let late = world.spawn_empty().id();
        assert_eq!(table.insert(candidate(late)), slot_a);
        assert_eq!(table.slots(), 3);
    }

    #[test]
    fn an_entity_that_was_replaced_without_notice_gives_its_slot_up() {
        let mut world = World::new();
        let old = world.spawn_empty().id();
        let mut table = Candidates::default();
        table.begin();
        table.insert(candidate(old));
        let new = of_the_same_index(old);
        table.insert(candidate(new));
        assert_eq!((table.len(), table.slot(old)), (1, None));
    }
}
