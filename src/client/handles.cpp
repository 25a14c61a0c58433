// SPDX-License-Identifier: GPL-2.0-or-later
// What a program calls: Client, CheckOut, Task, Run. Each call is a use of the session's core or desk, and
// where it waits for an answer, it waits here.
#include "client/handles.hpp"

#include <algorithm>
#include <future>
#include <optional>
#include <stop_token>
#include <utility>

#include "axon/client.hpp"
#include "client/base/durations.hpp"
#include "client/core/entity_query.hpp"
#include "client/session.hpp"
#include "client/surveys.hpp"
#include "client/upload.hpp"
#include "common/shared_clock.hpp"
#include "common/waiting.hpp"

namespace axon::client {
namespace {

Refusal gone() {
    return {RefusalCode::NotConnected, "The client of this handle has been closed.", {}};
}

using Session = Client::Session;

/// `begin` gives the core an order to check out, and returns its number.
using BeginCheckOut = std::function<Id128(SessionCore&, const CheckOutOptions&, CheckOuts::Done)>;

/// Waits until all are granted, or refused; the caller makes handles of them.
Result<std::vector<std::shared_ptr<CheckOut::Shared>>> checkOutAll(const std::shared_ptr<Session>& session,
                                                                   const CheckOutOptions& options,
                                                                   const BeginCheckOut& begin) {
    session->mayWait();
    // The handles are made under the core's lock, so that nothing the entities say from now on is missed.
    using Answer = Result<std::vector<std::shared_ptr<CheckOut::Shared>>>;
    auto promise = std::make_shared<std::promise<Answer>>();
    auto future = promise->get_future();
    auto for_core = options;
    if (options.on_waiting) {
        for_core.on_waiting = [news = &session->news(), tell = options.on_waiting](const Waiting& waiting) {
            news->tell([tell, waiting] { tell(waiting); }, true);
        };
    }
    const auto order = session->withCore([&](SessionCore& core) {
        return begin(core, for_core,
                     [weak = std::weak_ptr(session), news = &session->news(), &core,
                      promise](Result<std::vector<Held>> granted) {
                         if (!granted) return promise->set_value(granted.refusal());
                         std::vector<std::shared_ptr<CheckOut::Shared>> made;
                         for (const auto& held : granted.value()) {
                             const auto entity = core.entities().entity(held.entity);
                             made.push_back(std::make_shared<CheckOut::Shared>(
                                 held, weak, entity ? entity.value() : Entity{held.entity}));
                             news->add(made.back());
                         }
                         promise->set_value(std::move(made));
                     });
    });
    const std::stop_callback cancel(options.give_up, [&session, order] {
        session->withCore([order](SessionCore& core) { core.checkOuts().giveUp(order); });
    });
    return future.get();
}

/// A reset or clear, and what became of it.
Result<Receipt> command(Session& session, const Held& held,
                        Result<void> (Commands::*give)(const Held&, std::int64_t)) {
    using Answer = Result<std::vector<Receipt>>;
    const auto promise = std::make_shared<std::promise<Answer>>();
    auto future = promise->get_future();
    const auto sequence = session.marks().nextSequence();
    session.stops().withDesk([&](StopDesk& desk) {
        desk.await(held.entity, sequence, timeoutOf(session.options()),
                   [promise](Answer answer) { promise->set_value(std::move(answer)); });
    });
    const auto sent =
        session.withCore([&](SessionCore& core) { return (core.commands().*give)(held, sequence); });
    if (!sent) {
        session.stops().withDesk([&](StopDesk& desk) { desk.withdraw(sequence); });
        return sent.refusal();
    }
    session.mayWait();  // after it has left, as a stop does
    auto receipts = future.get();
    if (!receipts) return receipts.refusal();
    if (receipts->empty() || !receipts->front().manager)
        return Refusal{
            RefusalCode::TimedOut,
            "The entity has not answered in time; it is not known whether its task has ended. Look at it.",
            {}};
    return std::move(receipts->front());
}

// What handles of tasks and of runs have in common.

template <class Shared>
auto newest(Shared& shared) {
    const std::lock_guard lock(shared.mutex);
    return shared.report;
}

template <class Shared>
auto awaitEnd(Shared& shared, std::optional<Seconds> time) {
    std::shared_ptr<const Clock> clock = std::make_shared<SteadyClock>();
    if (const auto session = shared.session.lock()) {
        session->mayWait();
        clock = session->clock();
    }
    std::unique_lock lock(shared.mutex);
    const auto over = [&] { return shared.over(); };
    if (time) {
        waitUntil(shared.changed, lock, *clock, clock->now() + toDuration(*time), over);
    } else {
        shared.changed.wait(lock, over);
    }
    return shared.report;
}

template <class Shared, class Callback>
void listen(const std::shared_ptr<Shared>& shared, Callback callback) {
    const auto session = shared->session.lock();
    if (!session) return;
    std::shared_ptr<void> untold;
    // Under the handle's lock, so that no change comes between the first call and the next.
    const std::lock_guard lock(shared->mutex);
    if (isFinal(shared->report.state)) untold = whileUntold(shared);
    session->news().post([callback, report = shared->report, untold] { callback(report); }, false);
    shared->callbacks.push_back(std::move(callback));
}

void control(SessionCore& core, const Task::Shared& task, proto::TaskAction action, Done done) {
    core.tasks().control(task.id, action, std::move(done));
}

void control(SessionCore& core, const Run::Shared& run, proto::TaskAction action, Done done) {
    core.runs().control(run.id, action, std::move(done));
}

template <class Shared>
Result<void> askFor(proto::TaskAction action, const Shared& shared) {
    const auto session = shared.session.lock();
    if (!session) return gone();
    return session->template ask<Result<void>>(
        [&](SessionCore& core, auto done) { control(core, shared, action, std::move(done)); });
}

}  // namespace

Client::Client(std::shared_ptr<Session> session) : session_(std::move(session)) {}

Client::~Client() {
    session_->close();
}

Result<std::unique_ptr<Client>> Client::connect(Options options) {
    std::shared_ptr<const Clock> clock;
    try {
        clock = clockFromEnvironment();
    } catch (const std::exception& error) {
        return Refusal{RefusalCode::Malformed, error.what(), {}};
    }
    if (options.server.starts_with("http://") || options.server.starts_with("https://"))
        return Refusal{
            RefusalCode::Malformed,
            "'" + options.server +
                "' is the address of a web page, such as the web console; clients use another port "
                "of the server, 10410 by default; fix: give HOST:PORT, as in client=HOST:PORT of "
                "the line that axon-server prints at its start",
            {}};
    auto session = std::make_shared<Session>(std::move(options), std::move(clock));
    const auto connected = session->connect();
    if (!connected) {
        session->close();
        return connected.refusal();
    }
    return std::unique_ptr<Client>(new Client(std::move(session)));
}

void Client::close() {
    session_->close();
}

bool Client::connected() const {
    return session_->look([](const SessionCore& core) { return core.connected(); });
}

Sender Client::self() const {
    return session_->look([](const SessionCore& core) { return core.self(); });
}

std::string Client::server() const {
    return session_->options().server;
}

std::vector<Entity> Client::entities(Listed listed) const {
    return session_->look([&](const SessionCore& core) { return core.entities().list(listed); });
}

Result<Entity> Client::find(std::string_view name) const {
    return session_->look([&](const SessionCore& core) { return core.entities().find(name); });
}

Result<Entity> Client::waitFor(std::string_view name, Seconds time) const {
    return session_->waitFor(name, time);
}

void Client::onEntity(std::function<void(Presence, const Entity&)> callback) {
    session_->news().setOnEntity(std::move(callback));
}

void Client::onConnection(std::function<void(bool, const std::string&)> callback) {
    session_->news().setOnConnection(std::move(callback));
}

Result<std::vector<CheckOut>> Client::checkOut(const std::vector<std::string>& names,
                                               const CheckOutOptions& options) {
    return handlesOf(checkOutAll(session_, options,
                                 [&](SessionCore& core, const CheckOutOptions& with, CheckOuts::Done done) {
                                     return core.checkOuts().checkOut(names, with, std::move(done));
                                 }));
}

Result<CheckOut> Client::checkOut(std::string_view name, const CheckOutOptions& options) {
    auto all = checkOut(std::vector{std::string(name)}, options);
    if (!all) return all.refusal();
    return all->front();
}

Result<std::vector<CheckOut>> Client::checkOutQuery(std::string_view query, const CheckOutOptions& options) {
    const auto parsed = parseQuery(query);
    if (!parsed) return parsed.refusal();
    return handlesOf(checkOutAll(session_, options,
                                 [&](SessionCore& core, const CheckOutOptions& with, CheckOuts::Done done) {
                                     return core.checkOuts().checkOut(parsed.value(), with, std::move(done));
                                 }));
}

Result<CheckOut> Client::resume(std::string_view ticket) {
    const auto parsed = LeaseTicket::parse(ticket);
    if (!parsed) return parsed.refusal();
    auto all = handlesOf(
        checkOutAll(session_, {}, [&](SessionCore& core, const CheckOutOptions&, CheckOuts::Done done) {
            core.checkOuts().resume(parsed.value(), std::move(done));
            return Id128{};
        }));
    if (!all) return all.refusal();
    return all->front();
}

Result<std::vector<CheckOut>> Client::handlesOf(Granted granted) {
    if (!granted) return granted.refusal();
    std::vector<CheckOut> all;
    for (auto& made : granted.value()) all.push_back(CheckOut(std::move(made)));
    return all;
}

std::vector<CheckOut> Client::held() const {
    return session_->look([this](const SessionCore& core) {
        std::vector<CheckOut> all;
        for (const auto& check_out : session_->news().checkOuts()) {
            if (core.leases().holds(check_out->held)) all.push_back(CheckOut(check_out));
        }
        return all;
    });
}

Result<std::vector<Receipt>> Client::stop(const std::vector<std::string>& names, Seconds deadline,
                                          Seconds standstill) {
    using Answer = Result<std::vector<Receipt>>;
    const auto promise = std::make_shared<std::promise<Answer>>();
    auto future = promise->get_future();
    session_->stops().withDesk([&](StopDesk& desk) {
        desk.stop(
            names, toDuration(deadline), [promise](Answer answer) { promise->set_value(std::move(answer)); },
            toDuration(standstill));
    });
    session_->mayWait();  // after the stop has left: misuse is no reason not to stop
    auto answer = future.get();
    if (answer && dynamic_cast<const SharedClock*>(session_->clock().get()) != nullptr)
        for (auto& receipt : answer.value()) receipt.precision = SharedClockPage::kStep;
    return answer;
}

Result<void> Client::rearm(std::string_view name) {
    return session_->ask<Result<void>>([&](SessionCore& core, auto done) {
        const auto entity = core.entities().find(name);
        if (!entity) return done(entity.refusal());
        core.commands().rearm(entity->id, done);
    });
}

Result<std::vector<Service>> Client::services(std::string_view name) const {
    return session_->ask<Result<std::vector<Service>>>([&](SessionCore& core, auto done) {
        const auto entity = core.entities().find(name);
        if (!entity) return done(entity.refusal());
        core.entities().fetchServices(entity->id, done);
    });
}

Result<Details> Client::details(std::string_view name) const {
    return session_->ask<Result<Details>>([&](SessionCore& core, auto done) {
        const auto entity = core.entities().find(name);
        if (!entity) return done(entity.refusal());
        core.entities().fetchDetails(entity->id, done);
    });
}

Result<GlobalServices> Client::globalServices() const {
    return session_->ask<Result<GlobalServices>>(
        [](SessionCore& core, auto done) { core.runs().fetchServices(done); });
}

Result<Proposal> Client::propose(const GlobalService& service, const Bindings& chosen) const {
    return client::propose(*session_, service, chosen);
}

Result<Run> Client::beginRun(const GlobalService& service, const Bindings& bindings, std::string_view master,
                             bool check_only) {
    return session_->withCore([&](SessionCore& core) -> Result<Run> {
        if (auto overloaded = session_->messages().admit(0); !overloaded.ok()) return overloaded;
        RunOrder order{service, {}, {}, check_only, 0};
        for (const auto& [role, name] : bindings) {
            const auto entity = core.entities().find(name);
            if (!entity) return entity.refusal();
            order.players[role] = entity->id;
        }
        const auto entity = core.entities().find(master);
        if (!entity) return entity.refusal();
        order.master = entity->id;
        order.asked_at_ms = std::chrono::duration_cast<std::chrono::milliseconds>(
                                std::chrono::system_clock::now().time_since_epoch())
                                .count();
        const auto id = core.runs().run(order);
        if (!id) return id.refusal();
        auto run = std::make_shared<Run::Shared>(id.value(), session_, *core.runs().report(id.value()));
        if (!isFinal(run->report.state)) session_->news().add(run);
        return Run(std::move(run));
    });
}

Result<Run> Client::runGlobal(const GlobalService& service, const Bindings& bindings,
                              std::string_view master) {
    return beginRun(service, bindings, master, false);
}

Result<Run> Client::checkGlobal(const GlobalService& service, const Bindings& bindings,
                                std::string_view master) {
    return beginRun(service, bindings, master, true);
}

Result<RunHistory> Client::runHistory(const std::vector<std::string>& names, int most) const {
    return client::runHistory(*session_, names, most);
}

Result<std::vector<DrillReport>> Client::drill(const std::vector<std::string>& names, int count,
                                               Seconds period, std::stop_token give_up) {
    return client::drill(*session_, names, count, period, give_up);
}

Result<std::shared_ptr<void>> Client::watch(std::string_view name, const std::vector<std::string>& streams,
                                            std::function<void(const Sample&)> callback) {
    auto begun = session_->withCore([&](SessionCore& core) -> Result<std::uint64_t> {
        const auto entity = core.entities().find(name);
        if (!entity) return entity.refusal();
        const auto watching = core.watches().watch(entity->id, streams);
        if (!watching) return watching.refusal();
        return session_->news().addWatch(entity->id, streams, std::move(callback));
    });
    if (!begun) return begun.refusal();
    const auto unwatch = [weak = std::weak_ptr(session_), id = begun.value()](void*) {
        const auto session = weak.lock();
        if (!session) return;
        session->withCore([&](SessionCore& core) {
            const auto [entity, watched] = session->news().removeWatch(id);
            if (!entity.empty()) core.watches().unwatch(entity, watched);
        });
    };
    return std::shared_ptr<void>(static_cast<void*>(session_.get()), unwatch);
}

const std::string& Task::id() const {
    return shared_->text;
}
TaskReport Task::report() const {
    return newest(*shared_);
}
TaskReport Task::wait(std::optional<Seconds> time) const {
    return awaitEnd(*shared_, time);
}
void Task::onUpdate(std::function<void(const TaskReport&)> callback) const {
    listen(shared_, std::move(callback));
}
Result<void> Task::pause() const {
    return askFor(proto::PAUSE, *shared_);
}
Result<void> Task::resume() const {
    return askFor(proto::RESUME, *shared_);
}
Result<void> Task::cancel() const {
    return askFor(proto::CANCEL, *shared_);
}

const std::string& Run::id() const {
    return shared_->text;
}
RunReport Run::report() const {
    return newest(*shared_);
}
RunReport Run::wait(std::optional<Seconds> time) const {
    return awaitEnd(*shared_, time);
}
void Run::onUpdate(std::function<void(const RunReport&)> callback) const {
    listen(shared_, std::move(callback));
}
Result<void> Run::pause() const {
    return askFor(proto::PAUSE, *shared_);
}
Result<void> Run::resume() const {
    return askFor(proto::RESUME, *shared_);
}
Result<void> Run::cancel() const {
    return askFor(proto::CANCEL, *shared_);
}

Entity CheckOut::entity() const {
    if (const auto session = shared_->session.lock()) {
        auto now = session->look(
            [this](const SessionCore& core) { return core.entities().entity(shared_->held.entity); });
        if (now) {
            const std::lock_guard lock(shared_->mutex);
            shared_->last = now.value();
            return now.value();
        }
    }
    const std::lock_guard lock(shared_->mutex);
    return shared_->last;
}

std::vector<Service> CheckOut::services() const {
    const auto session = shared_->session.lock();
    if (!session) return {};
    auto all =
        session->look([this](const SessionCore& core) { return core.leases().services(shared_->held); });
    return all ? std::move(all).value() : std::vector<Service>{};
}

Result<Service> CheckOut::service(std::string_view name_or_global_id) const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    return session->look(
        [&](const SessionCore& core) { return core.leases().service(shared_->held, name_or_global_id); });
}

Result<void> CheckOut::set(std::string_view service, const Argument& argument) const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    return session->ask<Result<void>>(
        [&](SessionCore& core, auto done) { core.commands().set(shared_->held, service, argument, done); });
}

Result<void> CheckOut::upload(std::string_view service, std::string_view resource,
                              const std::filesystem::path& file,
                              std::function<void(std::uint64_t, std::uint64_t)> progress,
                              std::stop_token give_up) const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    return client::upload(*session, shared_->held, service, resource, file, progress, give_up);
}

Task CheckOut::run(std::string_view service, const std::vector<Argument>& arguments,
                   Seconds not_after) const {
    if (const auto session = shared_->session.lock()) {
        return session->withCore([&](SessionCore& core) {
            if (const auto overloaded = session->messages().admit(0); !overloaded.ok()) {
                const auto id = Id128::uuid(session->random());
                TaskReport report{id.toString(), shared_->held.entity, std::string(service)};
                report.state = TaskState::Refused;
                report.reason = overloaded;
                return Task(std::make_shared<Task::Shared>(id, session, report));
            }
            const auto id = core.tasks().run(shared_->held, service, arguments, toDuration(not_after));
            auto task = std::make_shared<Task::Shared>(id, session, *core.tasks().report(id));
            if (!isFinal(task->report.state)) session->news().add(task);
            return Task(std::move(task));
        });
    }
    TaskReport report;
    report.entity = shared_->held.entity;
    report.service = std::string(service);
    report.state = TaskState::Refused;
    report.reason = gone();
    return Task(std::make_shared<Task::Shared>(Id128{}, shared_->session, report));
}

Result<void> CheckOut::sendText(std::string_view text) const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    // Asked once before the lock, so that who tries again and again does not wear it out.
    if (auto refusal = session->messages().admit(text.size()); !refusal.ok()) return refusal;
    return session->withCore([&](SessionCore& core) -> Result<void> {
        if (auto refusal = session->messages().admit(text.size()); !refusal.ok()) return refusal;
        return core.commands().sendText(shared_->held, text);
    });
}

Result<void> CheckOut::sendRaw(std::string_view bytes, Seconds wait) const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    // Asked once before the lock, so that who tries again and again does not wear it out.
    if (wait > Seconds{0}) session->messages().awaitRoom(toDuration(wait));
    if (auto refusal = session->messages().admit(bytes.size()); !refusal.ok()) return refusal;
    return session->withCore([&](SessionCore& core) -> Result<void> {
        if (auto refusal = session->messages().admit(bytes.size()); !refusal.ok()) return refusal;
        return core.commands().sendRaw(shared_->held, bytes);
    });
}

void CheckOut::onText(std::function<void(const std::string&)> callback) const {
    const std::lock_guard lock(shared_->mutex);
    shared_->text = std::move(callback);
}

void CheckOut::onRaw(std::function<void(const std::string&)> callback) const {
    const std::lock_guard lock(shared_->mutex);
    shared_->raw = std::move(callback);
}

void CheckOut::onServiceChanged(std::function<void(const Service&)> callback) const {
    const std::lock_guard lock(shared_->mutex);
    shared_->service = std::move(callback);
}

void CheckOut::onLost(std::function<void(const Refusal&)> callback) const {
    const auto session = shared_->session.lock();
    const std::lock_guard lock(shared_->mutex);
    if (shared_->lost_why && session && callback) {
        session->news().post([callback, why = *shared_->lost_why] { callback(why); }, false);
    }
    shared_->lost = std::move(callback);
}

void CheckOut::onOrphaned(std::function<void(const std::string&)> callback) const {
    const std::lock_guard lock(shared_->mutex);
    shared_->orphaned = std::move(callback);
}

void CheckOut::onResumed(std::function<void()> callback) const {
    const std::lock_guard lock(shared_->mutex);
    shared_->resumed = std::move(callback);
}

bool CheckOut::orphaned() const {
    const auto session = shared_->session.lock();
    return session &&
           session->look([this](const SessionCore& core) { return core.leases().orphaned(shared_->held); });
}

void CheckOut::onHandOverRequest(std::function<void(const HandOverRequest&)> callback) const {
    const auto session = shared_->session.lock();
    if (!session) return;
    // Under the core's lock, so that no request comes between the look and the callback's being there.
    session->look([&](const SessionCore& core) {
        const auto open = core.leases().question(shared_->held);
        const std::lock_guard lock(shared_->mutex);
        if (open && callback) session->news().post([callback, open] { callback(*open); }, false);
        shared_->hand_over = std::move(callback);
    });
}

std::optional<HandOverRequest> CheckOut::handOverRequest() const {
    const auto session = shared_->session.lock();
    if (!session) return std::nullopt;
    return session->look([this](const SessionCore& core) { return core.leases().question(shared_->held); });
}

Result<void> CheckOut::answerHandOver(bool accept, std::string_view reason) const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    return session->withCore(
        [&](SessionCore& core) { return core.leases().answerHandOver(shared_->held, accept, reason); });
}

Result<void> CheckOut::setHandOverPolicy(const HandOverPolicy& policy) const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    return session->withCore(
        [&](SessionCore& core) { return core.leases().setHandOverPolicy(shared_->held, policy); });
}

bool CheckOut::direct() const {
    const auto session = shared_->session.lock();
    return session && session->direct(shared_->held);
}

std::string CheckOut::ticket() const {
    const auto session = shared_->session.lock();
    if (!session) return {};
    const auto ticket =
        session->look([this](const SessionCore& core) { return core.leases().ticket(shared_->held); });
    return ticket ? ticket->toText() : std::string();
}

Result<Receipt> CheckOut::reset() const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    return command(*session, shared_->held, &Commands::reset);
}

Result<Receipt> CheckOut::clear() const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    return command(*session, shared_->held, &Commands::clear);
}

Result<void> CheckOut::release() const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    return session->ask<Result<void>>([&](SessionCore& core, auto done) {
        session->news().remove(shared_->held);
        core.leases().release(shared_->held, done);
    });
}

}  // namespace axon::client
