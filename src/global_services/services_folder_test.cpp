// SPDX-License-Identifier: GPL-2.0-or-later
#include "global_services/services_folder.hpp"

#include <axon/messages.pb.h>
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <optional>
#include <utility>
#include <vector>

#include "common/descriptor.hpp"

namespace axon::global_services {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::SizeIs;

std::string service(const std::string& name) {
    return "<Service name='" + name +
           "'>\n<entity category='ROBOT' type='MOBILE' id='0' service_global_id='walk' "
           "preced='1'/></Service>\n";
}

std::string profile(const std::string& services) {
    return "<GlobalProfile>\n" + services + "</GlobalProfile>\n";
}

class ServicesFolderTest : public testing::Test {
  protected:
    ServicesFolderTest() {
        std::string name = std::filesystem::temp_directory_path() / "axon-services-XXXXXX";
        folder = ::mkdtemp(name.data());
    }
    ~ServicesFolderTest() override { std::filesystem::remove_all(folder); }

    void write(const std::string& name, const std::string& text) const {
        std::ofstream(folder / name, std::ios::binary) << text;
    }
    /// As an editor or a deployment does it: the new file takes the old one's place.
    void replace(const std::string& name, const std::string& text) const {
        write(name + ".new", text);
        std::filesystem::rename(folder / (name + ".new"), folder / name);
    }
    void open() {
        services.emplace(folder, clock, [this](const std::string& line) { notes.push_back(line); });
    }
    void pass(Duration time = ServicesFolder::kPeriod) {
        clock.advance(time);
        services->onTimer();
    }
    proto::GlobalServices served() {
        proto::ToEntity request;
        request.mutable_global_services()->set_request_id("7");
        const auto answer = services->answer(request.SerializeAsString());
        proto::ToClient message;
        EXPECT_TRUE(answer.ok() && message.ParseFromString(answer.value()) && message.has_global_services());
        EXPECT_EQ(message.global_services().request_id(), "7");
        return message.global_services();
    }
    /// "a.xml: Walk Talk", "b.xml is bad"
    std::vector<std::string> files() {
        std::vector<std::string> out;
        const auto all = served();
        for (const auto& file : all.files()) {
            std::string line = file.name() + (file.bad() ? " is bad" : ":");
            for (const auto& one : file.profile().services()) line += " " + one.name();
            out.push_back(line);
        }
        return out;
    }
    std::vector<std::string> said() { return std::exchange(notes, {}); }

    std::filesystem::path folder;
    ManualClock clock;
    std::vector<std::string> notes;
    std::optional<ServicesFolder> services;
};

TEST_F(ServicesFolderTest, ServesEveryProfileOfItsFolderInTheOrderOfTheirNames) {
    write("b.xml", profile(service("Talk")));
    write("a.xml", profile(service("Walk") + service("Run")));
    write("notes.txt", "no profile");
    write(".a.xml.swp.xml", "an editor's");
    std::filesystem::create_directory(folder / "more.xml");
    open();
    EXPECT_THAT(files(), ElementsAre("a.xml: Walk Run", "b.xml: Talk"));
    EXPECT_THAT(said(), ElementsAre("global services: a.xml offers 2 services: \"Walk\", \"Run\"",
                                    "global services: b.xml offers 1 service: \"Talk\""));
}

TEST_F(ServicesFolderTest, TheFigureOfTheThesisIsServedAndWhatIsOddIsSaid) {
    std::filesystem::copy_file("api/schema/samples/valid/figure_a_1.xml", folder / "figure_a_1.xml");
    open();
    EXPECT_THAT(files(), ElementsAre("figure_a_1.xml: Collaboration Demo Pick and Place Demo"));
    const std::string odd =
        "figure_a_1.xml:2: warning: GlobalProfile count: the number of services, which is 2, found 3: write "
        "2 or "
        "leave the attribute out";
    EXPECT_THAT(served().files(0).findings(), ElementsAre(odd));
    EXPECT_THAT(said(),
                ElementsAre("global services: figure_a_1.xml offers 2 services: \"Collaboration Demo\", "
                            "\"Pick and Place Demo\"",
                            "global services: " + odd));
}

TEST_F(ServicesFolderTest, NoticesWhatIsNewChangedReplacedAndGoneAndSaysEachOnce) {
    write("a.xml", profile(service("Walk")));
    open();
    said();
    for (int i = 0; i < 5; ++i) pass();
    EXPECT_THAT(said(), IsEmpty()) << "nothing has changed";

    write("b.xml", profile(service("Talk")));
    pass(ServicesFolder::kPeriod / 2);
    EXPECT_THAT(files(), ElementsAre("a.xml: Walk")) << "it is not time yet";
    pass(ServicesFolder::kPeriod / 2);
    EXPECT_THAT(files(), ElementsAre("a.xml: Walk", "b.xml: Talk"));
    EXPECT_THAT(said(), ElementsAre(HasSubstr("b.xml offers")));

    replace("a.xml", profile(service("Jump")));
    pass();
    EXPECT_THAT(files(), ElementsAre("a.xml: Jump", "b.xml: Talk")) << "of the same size";
    EXPECT_THAT(said(), ElementsAre(HasSubstr("a.xml offers 1 service: \"Jump\"")));

    std::filesystem::remove(folder / "b.xml");
    pass();
    EXPECT_THAT(files(), ElementsAre("a.xml: Jump"));
    EXPECT_THAT(said(), ElementsAre("global services: b.xml is gone"));

    replace("a.xml", profile(service("Jump")));
    for (int i = 0; i < 5; ++i) pass();
    EXPECT_THAT(said(), IsEmpty()) << "another file that says the same";
}

TEST_F(ServicesFolderTest, AFileThatIsWrittenInPlaceIsReadWhenItIsWhole) {
    const auto whole = profile(service("Walk"));
    write("a.xml", whole.substr(0, 20));
    open();
    EXPECT_THAT(files(), ElementsAre("a.xml is bad"));
    std::ofstream(folder / "a.xml", std::ios::app) << whole.substr(20);
    pass();
    EXPECT_THAT(files(), ElementsAre("a.xml: Walk"));
}

TEST_F(ServicesFolderTest, AFileThatIsWrittenWithoutATraceInTheMomentOfReadingIsReadOnceMore) {
    const auto text = profile(service("Walk"));
    write("a.xml", text);
    // Stores into a page that is dirty already change neither the times nor the size.
    const Descriptor file(::open((folder / "a.xml").c_str(), O_RDWR));
    auto* const page =
        static_cast<char*>(::mmap(nullptr, text.size(), PROT_READ | PROT_WRITE, MAP_SHARED, file.get(), 0));
    ASSERT_NE(page, MAP_FAILED);
    page[0] = ' ';
    open();
    EXPECT_THAT(files(), ElementsAre("a.xml is bad"));
    page[0] = '<';
    pass();
    EXPECT_THAT(files(), ElementsAre("a.xml: Walk"));
    ::munmap(page, text.size());
}

TEST_F(ServicesFolderTest, AFileWithAnErrorOffersNothingAndTheOthersGoOn) {
    write("a.xml", profile("<Service/>"));
    write("b.xml", profile(service("Walk")));
    open();
    EXPECT_THAT(files(), ElementsAre("a.xml is bad", "b.xml: Walk"));
    EXPECT_THAT(served().files(0).findings(), Contains(HasSubstr("a.xml:2: error: Service name: a name")));
    EXPECT_THAT(said(), Contains("global services: a.xml has errors, so its services are not offered"));
    replace("a.xml", profile(service("Talk")));
    pass();
    EXPECT_THAT(files(), ElementsAre("a.xml: Talk", "b.xml: Walk"));
}

TEST_F(ServicesFolderTest, TheNameOfAServiceIsThatOfTheFirstFile) {
    write("a.xml", profile(service("Walk")));
    write("b.xml", profile(service("Talk") + service("Walk")));
    open();
    EXPECT_THAT(files(), ElementsAre("a.xml: Walk", "b.xml is bad"));
    EXPECT_THAT(
        served().files(1).findings(),
        ElementsAre(
            "b.xml:4: error: Service \"Walk\" name: a service name that no other file has; it is also "
            "in a.xml, line 2: rename one of the two, or remove one of the files"));
    said();
    std::filesystem::remove(folder / "a.xml");
    pass();
    EXPECT_THAT(files(), ElementsAre("b.xml: Talk Walk"));
    EXPECT_THAT(said(), ElementsAre(HasSubstr("b.xml offers 2"), HasSubstr("a.xml is gone")));
}

TEST_F(ServicesFolderTest, AFolderMayComeLaterAndGo) {
    std::filesystem::remove(folder);
    open();
    EXPECT_THAT(files(), IsEmpty());
    EXPECT_THAT(said(), IsEmpty()) << "most servers have none";
    pass();
    EXPECT_THAT(said(), IsEmpty());
    std::filesystem::create_directory(folder);
    write("a.xml", profile(service("Walk")));
    pass();
    EXPECT_THAT(files(), ElementsAre("a.xml: Walk"));
    said();
    std::filesystem::remove_all(folder);
    pass();
    EXPECT_THAT(files(), IsEmpty());
    EXPECT_THAT(said(), ElementsAre(AllOf(HasSubstr(folder.string()), HasSubstr("is gone"),
                                          HasSubstr("no global services are offered")),
                                    HasSubstr("a.xml is gone")));
}

TEST_F(ServicesFolderTest, ReadsAtMost256FilesAndSaysHowManyMoreThereAre) {
    for (int i = 0; i < 300; ++i) {
        const auto number = std::to_string(1000 + i);
        write(number + ".xml", profile(service("S" + number)));
    }
    open();
    const auto all = served();
    ASSERT_EQ(all.files_size(), 257);
    EXPECT_EQ(all.files(255).name(), "1255.xml");
    EXPECT_EQ(all.files(256).name(), folder.filename().string());
    EXPECT_TRUE(all.files(256).bad());
    EXPECT_THAT(all.files(256).findings(), ElementsAre(HasSubstr("at most 256 files; 44 more")));
}

TEST_F(ServicesFolderTest, AFileAboveOneMebibyteIsAnErrorAndSoIsWhatDoesNotFitIntoAnAnswer) {
    const std::string blanks(600 * 1024, ' ');
    const auto with_text = [&](const std::string& name) {
        return "<GlobalProfile><Service name='" + name + "' descr='" + blanks +
               "'><entity category='ROBOT' type='MOBILE' id='0' service_global_id='walk' "
               "preced='1'/></Service></GlobalProfile>";
    };
    write("a.xml", std::string(1024 * 1024 + 1, ' '));
    for (const char* name : {"b", "c", "d", "e"}) write(std::string(name) + ".xml", with_text(name));
    write("f.xml", profile(service("Walk")));
    open();
    EXPECT_THAT(files(), ElementsAre("a.xml is bad", "b.xml: b", "c.xml: c", "d.xml: d", "e.xml is bad",
                                     "f.xml: Walk"));
    EXPECT_THAT(served().files(4).findings(), ElementsAre(HasSubstr("at most 2048 KiB")));
    EXPECT_LT(served().ByteSizeLong(), ServicesFolder::kAnswerBytesMax);
}

TEST_F(ServicesFolderTest, NamesAndTextsThatAreNoUtf8DoNotSpoilTheAnswer) {
    write("\xff.xml", "<GlobalProfile \xff/>");
    open();
    EXPECT_THAT(files(), ElementsAre("\xef\xbf\xbd.xml is bad"));
}

TEST_F(ServicesFolderTest, RefusesWhatIsNoRequest) {
    open();
    EXPECT_EQ(services->answer("\xff").refusal().code, RefusalCode::Malformed);
    EXPECT_EQ(services->answer({}).refusal().code, RefusalCode::Malformed);
    proto::ToEntity request;
    request.mutable_global_services()->set_request_id(std::string(65, 'x'));
    EXPECT_EQ(services->answer(request.SerializeAsString()).refusal().code, RefusalCode::Malformed);
}

}  // namespace
}  // namespace axon::global_services
