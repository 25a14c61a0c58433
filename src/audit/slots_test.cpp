// SPDX-License-Identifier: GPL-2.0-or-later
#include "audit/slots.hpp"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "audit/testing.hpp"

namespace axon::audit {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

struct AuditSlots : testing::Test {
    ~AuditSlots() override { ::shm_unlink(object.c_str()); }
    static bool push(Ring& ring, const std::string& what) {
        return ring.push({.kind = Kind::Stop, .what = what}, 7);
    }
    /// As somebody else would leave it.
    void write(const std::string& content, mode_t mode = 0600) const {
        const Descriptor fd(::shm_open(object.c_str(), O_RDWR | O_CREAT, 0600));
        ASSERT_TRUE(fd.open());
        ASSERT_EQ(::fchmod(fd.get(), mode), 0);
        ASSERT_EQ(::ftruncate(fd.get(), 0), 0);
        ASSERT_EQ(::write(fd.get(), content.data(), content.size()), static_cast<ssize_t>(content.size()));
    }
    bool exists() const { return Descriptor(::shm_open(object.c_str(), O_RDONLY, 0)).open(); }

    TrailFolder folder;
    const std::string object = Slots::nameOf(folder.path, "server");
};

TEST_F(AuditSlots, WhatWasPushedAndNotDroppedIsThereInTheNextLifeInItsOrder) {
    {
        Slots slots(folder.path, "server", 8);
        EXPECT_THAT(slots.whyNot(), IsEmpty());
        EXPECT_THAT(slots.takeLeft(), IsEmpty());
        Ring ring(slots.all());
        // Around the end of the ring.
        for (int i = 0; i < 13; ++i) {
            ASSERT_TRUE(push(ring, std::to_string(i)));
            if (i < 9) ring.drop();
        }
    }
    Slots slots(folder.path, "server", 8);
    const auto left = slots.takeLeft();
    ASSERT_THAT(left, SizeIs(4));
    for (std::size_t i = 0; i < left.size(); ++i) {
        EXPECT_EQ(left[i].text(5), std::to_string(9 + i));
        EXPECT_EQ(left[i].at_us, 7);
    }
    EXPECT_THAT(slots.takeLeft(), IsEmpty());
    Ring ring(slots.all());
    for (int i = 0; i < 8; ++i) EXPECT_TRUE(push(ring, "again")) << "a slot is not free";
    EXPECT_FALSE(push(ring, "one more"));
}

TEST_F(AuditSlots, AreGoneWhenNothingWaitsInThem) {
    {
        Slots slots(folder.path, "server", 8);
        EXPECT_TRUE(exists());
        slots.forget();
    }
    EXPECT_FALSE(exists());
}

TEST_F(AuditSlots, AnotherTrailHasOthers) {
    Slots slots(folder.path, "server", 8), other(folder.path, "manager", 8);
    EXPECT_THAT(other.whyNot(), IsEmpty());
    other.forget();
}

TEST_F(AuditSlots, OfTwoProcessesOneHasMemoryOfItsOwn) {
    Slots first(folder.path, "server", 8), second(folder.path, "server", 8);
    EXPECT_THAT(first.whyNot(), IsEmpty());
    EXPECT_THAT(second.whyNot(), HasSubstr("another process"));
    Ring one(first.all()), two(second.all());
    EXPECT_TRUE(push(two, "of the second"));
    EXPECT_EQ(one.front(), nullptr);
    EXPECT_NE(two.front(), nullptr);
    second.forget();
    EXPECT_TRUE(exists()) << "it is the first one's";
}

TEST_F(AuditSlots, WhatSomebodyElseHasMadeIsNotUsed) {
    write("", 0666);
    Slots slots(folder.path, "server", 8);
    EXPECT_THAT(slots.whyNot(), HasSubstr("not this user's alone; fix: delete it"));
    Ring ring(slots.all());
    EXPECT_TRUE(push(ring, "all the same"));
}

TEST_F(AuditSlots, WhateverLiesThereBreaksNothing) {
    const std::size_t bytes = 64 + 8 * sizeof(Ring::Slot);
    for (const auto& content : {std::string(), std::string("short"), std::string(bytes, '\0'),
                                std::string(bytes, '\xff'), std::string(bytes + 1, 'x')}) {
        write(content);
        Slots slots(folder.path, "server", 8);
        EXPECT_THAT(slots.takeLeft(), IsEmpty());
        Ring ring(slots.all());
        EXPECT_TRUE(push(ring, "one"));
    }
    // The beginning is ours, and what follows is damaged: lengths that lead out of a slot.
    {
        Slots slots(folder.path, "server", 8);
        slots.takeLeft();
        Ring ring(slots.all());
        EXPECT_TRUE(push(ring, "one"));
        EXPECT_TRUE(push(ring, "two"));
        auto& kept = slots.all()[0].kept;
        kept.ends.fill(0xffff);
    }
    Slots slots(folder.path, "server", 8);
    EXPECT_THAT(slots.takeLeft(), SizeIs(1));
}

TEST_F(AuditSlots, AnotherNumberOfSlotsBeginsAnew) {
    {
        Slots slots(folder.path, "server", 8);
        Ring ring(slots.all());
        EXPECT_TRUE(push(ring, "one"));
    }
    Slots slots(folder.path, "server", 16);
    EXPECT_THAT(slots.whyNot(), IsEmpty());
    EXPECT_THAT(slots.all(), SizeIs(16));
    EXPECT_THAT(slots.takeLeft(), IsEmpty());
}

}  // namespace
}  // namespace axon::audit
